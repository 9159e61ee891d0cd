"""The search against a naive reference, and properties that hold for any volume."""

import itertools

import numpy as np
import pytest

from depthcli.methods.confidence import CostCurves, measure
from depthcli.methods.registration._search_kernels import MAX_SMALL_VALUE
from depthcli.methods.registration.search import displacements, search
from depthcli.testing.inputs import threads
from tests.naive import registration as naive


def channels(seed, shape, count=2, top=MAX_SMALL_VALUE):
    return np.random.default_rng(seed).integers(0, top + 1, (count, *shape), dtype=np.uint8)


@pytest.mark.slow
@pytest.mark.parametrize(("span", "power"), [("cube", 10), ("planes", 5), ("axes", 2), ("cube", 1)])
@pytest.mark.parametrize(
    ("shape", "count", "half", "top"), [((4, 5, 6), 2, 1, 85), ((1, 6, 5), 4, 2, 255), ((3, 3, 3), 1, 0, 255)]
)
def test_measures_agree_with_the_naive_reference(span, power, shape, count, half, top):
    fixed, warped = channels(0, shape, count, top), channels(1, shape, count, top)
    fixed[0, 0, 0, 0] = top
    found = search(fixed, warped, 1.5, 2, half, power, span, costly=True)
    offsets = naive.displacements(shape, 2, span)
    assert [tuple(d) for d in displacements(shape, 2, span)] == offsets
    costs = naive.curves(fixed, warped, 2, half, span)
    expected = naive.measures(costs, offsets, 1.5, power)
    maps = {**found.maps, "variance": found.variance, "border": found.border}
    for name, values in expected.items():
        units = top if name in ("cur0", "cost0", "msm") else 1
        slack = 2e-3 * max(units / 20, 1)
        np.testing.assert_allclose(maps[name] * units, values, rtol=2e-3, atol=slack, err_msg=name)


def test_stereo_measures_of_a_line_equal_those_of_a_stereo_pair():
    fixed, warped = channels(9, (1, 1, 40), 3), channels(10, (1, 1, 40), 3)
    found = search(fixed, warped, 1.0, 6, 2, costly=True)
    offsets = np.array(naive.displacements((1, 1, 40), 6, "cube"))[:, 2]
    costs = naive.curves(fixed, warped, 6, 2, "cube")[np.argsort(offsets), 0, 0].T.astype(np.float32)
    for x, curve in enumerate(costs):  # one by one: stereo takes the deviation over all curves that it is given
        alone = CostCurves(curve[None, None])
        for name in ("pkr", "mlm", "aml"):
            assert found.maps[name][0, 0, x] == pytest.approx(measure(name)(alone)[0, 0], rel=2e-3), (name, x)


def assert_same(found, every, stride=1):
    """The same values as at every n-th voxel of another search."""
    maps = {**every.maps, "displacement": every.displacement, "border": every.border}
    for name, values in {**found.maps, "displacement": found.displacement, "border": found.border}.items():
        np.testing.assert_array_equal(values, maps[name][..., ::stride, ::stride, ::stride], err_msg=name)


def test_same_bytes_at_any_tile_and_thread_count():
    views = channels(2, (9, 13, 17), 6), channels(3, (9, 13, 17), 6)
    whole = search(*views, 1.0, 2, 2, costly=True)
    for count, tile in itertools.product((1, 2), ((9, 13, 17), (4, 5, 7), (1, 1, 3))):
        with threads(count):
            assert_same(search(*views, 1.0, 2, 2, costly=True, tile=tile), whole)


@pytest.mark.parametrize("stride", [2, 3, 5])
@pytest.mark.parametrize("shape", [(9, 11, 13), (1, 8, 7)])
def test_measures_at_a_stride_equal_those_at_every_voxel(stride, shape):
    views = channels(7, shape, 4), channels(8, shape, 4)
    every = search(*views, 1.0, 2, 2, costly=True)
    for tile in ({}, {"tile": (1, 2, 1)}):
        assert_same(search(*views, 1.0, 2, 2, costly=True, stride=stride, **tile), every, stride)


@pytest.mark.parametrize("offset", [(0, 0, 0), (2, 0, 0), (0, -1, 0), (1, 2, -2)])
def test_expected_displacement_of_a_shifted_volume_is_the_shift(offset):
    wide = channels(4, (18, 18, 18), 3)
    places = [tuple(slice(3 - d, 15 - d) for d in each) for each in ((0, 0, 0), offset)]
    found = search(*(np.ascontiguousarray(wide[(slice(None), *part)]) for part in places), 2.0, 3, 1)
    means = found.displacement[:, 4:8, 4:8, 4:8].reshape(3, -1).T
    assert np.allclose(means, 2.0 * np.array(offset), atol=0.05)
    assert np.allclose(found.maps["shift"][4:8, 4:8, 4:8], 2 * np.linalg.norm(offset))
