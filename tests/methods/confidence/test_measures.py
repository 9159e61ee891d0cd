import numpy as np
import pytest

from depthcli.kernels.exponential import exp_minus
from depthcli.methods.confidence import CostCurves, confidence_maps, measure, measures
from depthcli.testing import confidence
from tests.golden import refused
from tests.naive import confidence as naive

CURVE_MEASURES = ("msm", "cur", "pkr", "pkrn", "mm", "mmn", "wmn", "wmnn", "mlm", "aml", "nem", "noi")


def random_costs(shape, dtype, seed=0, levels=None):
    rng = np.random.default_rng(seed)
    top = levels or (200 if dtype == np.uint8 else 4000)
    costs = rng.integers(0, top, shape) if dtype != np.float32 else rng.random(shape) * 3
    return costs.astype(dtype)


@pytest.mark.parametrize("name", measures())
@pytest.mark.parametrize("check", confidence.CHECKS, ids=lambda check: check.__name__)
def test_contract(name, check):
    check(measure(name))


def test_a_measure_that_writes_into_the_costs_is_found():
    def writing(curves):
        curves.costs[0, 0] //= 2
        return measure("msm")(curves)

    with pytest.raises(AssertionError):  # in numpy's words
        confidence.same_at_any_number_of_threads(writing)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("n_disparities", [1, 2, 3, 15, 16, 17, 31, 33, 60])
@pytest.mark.parametrize("levels", [None, 3])
def test_every_curve_measure_agrees_with_its_reference(dtype, n_disparities, levels):
    costs, ramp = random_costs((40, n_disparities), dtype, n_disparities, levels), np.arange(n_disparities)
    costs[0], costs[1], costs[2] = 5, ramp, ramp[::-1]
    valid = np.random.default_rng(1).integers(1, n_disparities + 1, 40)
    curves = CostCurves(costs.reshape(5, 8, -1), valid.reshape(5, 8))
    got = curves.statistics
    assert (CostCurves(costs).valid == n_disparities).all()
    maps = {name: measure(name)(curves).ravel() for name in CURVE_MEASURES}
    mean, deviation = naive.spread(costs, valid)
    assert got.eps == pytest.approx(1e-3 * mean, rel=1e-4)
    for i in range(len(costs)):
        want, winner, second = naive.curve(costs[i], valid[i], deviation or 1.0, got.eps)
        assert (got.winner.flat[i], got.second_winner.flat[i]) == (winner, second)
        for name, value in want.items():
            assert maps[name][i] == pytest.approx(value, rel=2e-4, abs=2e-5), (name, i)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize(("width", "n_disparities"), [(23, 9), (7, 20), (1, 1), (1, 5), (30, 17)])
def test_measures_that_look_at_other_pixels_agree_with_their_references(dtype, width, n_disparities):
    costs = random_costs((6, width, n_disparities), dtype, width)
    maps = confidence_maps(costs, measures())
    valid = np.broadcast_to(np.minimum(np.arange(1, width + 1), n_disparities), (6, width))
    curves = CostCurves(costs, valid).statistics
    lrc, lrd = naive.left_right(costs, curves.eps)
    np.testing.assert_array_equal(maps["lrc"], lrc)
    np.testing.assert_allclose(maps["lrd"], lrd, rtol=1e-4)
    np.testing.assert_allclose(maps["da"], naive.agreement(curves.winner, 12), rtol=1e-6)
    apkr = naive.average_peak_ratio(costs, curves.winner, curves.second_winner, curves.eps, 2)
    np.testing.assert_allclose(maps["apkr"], apkr, rtol=1e-3)
    right, _ = naive.right_view(costs)
    joint = naive.agreement(curves.winner, 6) * naive.agreement(curves.winner, 6, right)
    joint *= np.sqrt(np.maximum(1 - 1 / apkr, 0))
    np.testing.assert_allclose(maps["dap"], joint, rtol=1e-2, atol=1e-3)


def test_unknown_names_are_refused_with_the_names_there_are():
    costs = random_costs((4, 5), np.uint8)
    refused(ValueError, confidence_maps, costs[None], ["pkrr"])
    refused(ValueError, confidence_maps, costs, ["pkr"])
    for given in ((costs, np.array([0, 1, 2, 3])), (costs[0],), (costs[:, :0],)):
        refused(ValueError, CostCurves, *given)


def test_exponential():
    x = np.linspace(0, 79, 2001).astype(np.float32)
    np.testing.assert_allclose([exp_minus(v) for v in x], np.exp(-x.astype(float)), rtol=1e-5)
    assert exp_minus(np.float32(1e30)) == pytest.approx(np.exp(-80.0), rel=1e-4)
