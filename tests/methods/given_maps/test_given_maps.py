"""Planes of maps against loops over single pixels, the network against numpy, and what the judgment is worth."""

import math
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from depthcli.algorithms.pixel_network import TILE
from depthcli.core.context import Clock
from depthcli.core.frames import StereoPair
from depthcli.core.maps import Status
from depthcli.methods import given_maps
from depthcli.methods.given_maps import _planes
from depthcli.methods.given_maps.fusion import fuse
from depthcli.problems.map_checks import networks
from depthcli.simulate.stereo_scenes import SyntheticScene, make_scene
from tests.contracts.inputs import preset
from tests.golden import refused
from tests.scenes import RealScene, real_pair, real_scenes


@pytest.fixture(scope="module")
def scene() -> SyntheticScene:
    return make_scene("planes", 3, 160, 120, 32)


@pytest.fixture(scope="module")
def pair(scene: SyntheticScene) -> StereoPair:
    return StereoPair(scene.left, scene.right)


@pytest.fixture(scope="module")
def broken(scene: SyntheticScene) -> np.ndarray:
    """The truth with a wrong block and a gap."""
    values = scene.disparity_left.copy()
    values[40:70, 60:100] += 6
    values[90:100, 100:120] = np.nan
    return values


def test_planes_are_those_of_single_pixels(pair: StereoPair, broken: np.ndarray):
    evidence = _planes.Evidence.of(pair, 32, Clock())
    (judged,) = given_maps.judged_maps(evidence, [broken])
    values, costs = judged.values, evidence.optimized.costs / evidence.optimized.scale
    rng = np.random.default_rng(0)
    for y, x in zip(rng.integers(0, 120, 60), rng.integers(0, 160, 60), strict=True):
        value, n = float(values[y, x]), min(33, x + 1)
        low = min(int(value), 32)
        here = costs[y, x, low]
        if low + 1 < 33:
            here += (value - low) * (costs[y, x, low + 1] - here)
        rank = np.count_nonzero(evidence.optimized.costs[y, x, :n] < int(here * evidence.optimized.scale + 1e-3)) / n
        assert judged.plane("rank")[y, x] == pytest.approx(rank, abs=1.5 / n)
        others = [costs[y, x, d] for d in range(n) if abs(d - int(value + 0.5)) > 1]
        margin = min(max(math.log((min(others, default=65535) + 2) / (here + 2)), -2), 2)
        assert judged.plane("margin")[y, x] == pytest.approx(margin, abs=2e-3)
        excess = min(math.log((here + 2) / (costs[y, x, evidence.left[y, x]] + 2)), 2)
        assert judged.plane("excess")[y, x] == pytest.approx(excess, abs=2e-3)
        assert judged.plane("missing")[y, x] == np.isnan(broken[y, x])


def test_the_kernel_is_the_network(pair: StereoPair, broken: np.ndarray):
    evidence, known = _planes.Evidence.of(pair, 32, Clock()), networks()
    judged = given_maps.judged_maps(evidence, [broken, broken + 1])[0]
    (w1, _), (w2, b2), (w3, b3) = known.right.layers
    inputs = np.concatenate([judged.alone, judged.others]).reshape(len(known.right.mean), -1).T
    scaled = np.clip((inputs - known.right.mean) * known.right.scale, -4, 4)
    want = np.maximum(np.maximum(scaled @ w1 + known.right.layers[0][1][1], 0) @ w2 + b2, 0) @ w3 + b3
    np.testing.assert_allclose(given_maps.odds_of(known, judged, 1.0).ravel(), want[:, 0], rtol=1e-3, atol=2e-3)


def test_a_wider_limit_is_never_less_likely(pair: StereoPair, broken: np.ndarray):
    """At the thresholds, between them and beyond, of maps that no network has seen."""
    evidence, known = _planes.Evidence.of(pair, 32, Clock()), networks()
    rng = np.random.default_rng(0)
    for values in (broken, rng.uniform(0, 32, broken.shape).astype(np.float32)):
        judged = given_maps.judged_maps(evidence, [values, broken])[0]
        limits = sorted([*np.geomspace(0.25, 8, 23), 1.0, 1.0001, 3.9999, 4.0])
        odds = np.stack([given_maps.odds_of(known, judged, limit) for limit in limits])
        assert (np.diff(odds, axis=0) >= 0).all()
        assert (np.diff(odds, axis=0) > 0).any(axis=0).mean() > 0.95
        half, one, next_, four = (given_maps.odds_of(known, judged, limit) for limit in (0.5, 1.0, math.sqrt(2), 4.0))
        np.testing.assert_allclose(given_maps.odds_of(known, judged, 2**0.25), (one + next_) / 2, atol=1e-5)
        np.testing.assert_array_equal(given_maps.odds_of(known, judged, 8.0), four)
        np.testing.assert_array_equal(given_maps.odds_of(known, judged, 0.25), half)


def test_pixels_beyond_the_right_image():
    values, right = np.array([[2, 0, 2, 3]], np.float32), np.array([[2, 0, 0, 0]], np.float32)
    nowhere = values < 0
    status = given_maps.with_reasons(values, nowhere, np.ones_like(values), values == 2)
    assert status.tolist() == [[Status.OUT_OF_RANGE, 0, Status.OCCLUDED, 0]]
    assert given_maps._left_right(SimpleNamespace(values=values), None, right).tolist() == [[-16, 0, 0, -1]]


def test_the_costs_are_those_of_the_preset_fast():
    fast, own = preset("stereo", "fast").pipeline, (_planes._COST, _planes._OPTIMIZATION, _planes._REFINEMENT)
    assert (fast.cost, fast.optimization, fast.refinement) == own


def test_one_map_has_no_relation_to_others(pair: StereoPair, broken: np.ndarray):
    evidence = _planes.Evidence.of(pair, 32, Clock())
    (judged,) = given_maps.judged_maps(evidence, [broken])
    assert not judged.others.any()
    first, second = given_maps.judged_maps(evidence, [broken, np.where(np.isnan(broken), broken, broken + 3)])
    assert first.plane("nearest_map")[10, 80] == pytest.approx(3)
    assert second.plane("above_middle")[10, 80] == pytest.approx(3)
    assert len(first.others) == len(_planes.OTHERS)
    refused(ValueError, given_maps.judged_maps, evidence, [broken[:, 1:]])


def test_wrong_pixels_are_doubted_and_hidden_ones_found(pair: StereoPair, scene: SyntheticScene, broken: np.ndarray):
    judgment = given_maps.judge(networks(), pair, [broken], 32, measures=given_maps.MEASURES)
    wrong = np.zeros(broken.shape, bool)
    wrong[42:68, 62:98] = True
    right = scene.nonocc & ~wrong & np.isfinite(broken)
    assert judgment.probability[wrong].mean() < 0.25
    assert judgment.probability[right].mean() > 0.9
    assert (judgment.probability[np.isnan(broken)] == 0).all()
    assert (judgment.status[np.isnan(broken)] == Status.NO_DATA).all()
    hidden = (judgment.status & int(Status.OCCLUDED | Status.OUT_OF_RANGE)) != 0
    both = np.count_nonzero(hidden & ~scene.nonocc)
    assert 2 * both / (hidden.sum() + np.count_nonzero(~scene.nonocc)) > 0.7
    assert set(judgment.confidence) == set(given_maps.MEASURES)
    for values in judgment.confidence.values():
        assert values.shape == broken.shape
        assert np.isfinite(values[np.isfinite(broken)]).all()


def test_the_best_of_two_halves(pair: StereoPair, scene: SyntheticScene):
    upper, lower = scene.disparity_left.copy(), scene.disparity_left.copy()
    upper[:60] += 5
    lower[60:] -= 3
    for surfaces in (False, True):
        best = fuse(networks(), pair, [upper, np.clip(lower, 0, None)], 32, surfaces=surfaces)
        error = np.abs(best.disparity.values - scene.disparity_left)[scene.nonocc]
        assert np.mean(error > 1) < 0.05
        assert np.isfinite(best.disparity.values).all()
        assert best.probability[scene.nonocc].mean() > 0.8


def test_without_a_right_image_only_the_shape_counts(pair: StereoPair, scene: SyntheticScene):
    values = scene.disparity_left.copy()
    values[40:60, 60:90] += np.random.default_rng(0).normal(0, 4, (20, 30)).astype(np.float32)
    measures = ["smoothness", "census"]
    found = given_maps.judge_by_one_view(networks(), pair.left, np.clip(values, 0, 32), 32, measures=measures)
    assert found.probability[42:58, 62:88].mean() < found.probability[80:110, 20:140].mean() - 0.3
    assert set(found.confidence) == {"smoothness"}
    refused(ValueError, given_maps.judge_by_one_view, networks(), pair.left, values[1:], 32)


def test_the_networks_were_trained_for_these_planes():
    right, hidden, one_view, *_ = networks()
    assert (right.inputs, hidden.inputs, one_view.inputs) == (_planes.INPUTS, _planes.ALONE, _planes.ONE_VIEW)
    assert right.maps == one_view.maps == given_maps.RIGHT_NAMES and hidden.maps == (given_maps.HIDDEN,)
    assert not any(weights.shape[1] % TILE for one in networks()[:3] for weights, _ in one.layers[:2])


def check_bounds(scene: RealScene, tolerance: float):
    """Shares inside of bounds of three levels, more if it is not known how a map was made, and nearly none of maps
    that the images contradict."""
    pair, truth, top = scene
    values = preset("stereo", "fast").pipeline(pair, top).disparity.values
    known = np.isfinite(truth.values) & (truth.values > 0) & np.isfinite(values)
    error = np.abs(values - truth.values)[known]
    for level in (0.5, 0.9, 0.98):
        probability, bound = given_maps.bounds(networks(), pair, values, np.False_, top, level=level)
        assert np.mean(error <= bound[known]) == pytest.approx(level, abs=tolerance)
        assert np.isfinite(bound).all()
        given = given_maps.judge(networks(), pair, [values], top, level=level).bound
        assert np.mean(error <= given[known]) > np.mean(error <= bound[known]) - 0.005
    assert probability[known].mean() == pytest.approx(np.mean(error <= 1), abs=0.05)
    for wrong in (np.zeros_like(values), np.nan_to_num(truth.values).astype(np.float32) / 16, values[::-1].copy()):
        judgment = given_maps.judge(networks(), pair, [wrong], top)
        assert judgment.probability[known].mean() < 0.1
        assert np.median(judgment.bound) > 8


@pytest.mark.slow
def test_bounds_cover_what_they_promise_on_the_real_pair():
    check_bounds(real_pair(), 0.13)


def test_bounds_cover_what_they_promise_on_real_scenes():
    for name in ("Dolls", "Art"):
        check_bounds(real_scenes("middlebury_2005")[name], 0.08)


def test_bounds_of_maps_computed_at_half_the_size():
    pair, truth, top = real_scenes("middlebury_2005")["Dolls"]
    height, width = pair.shape
    size = (width // 2, height // 2)
    small = StereoPair(*(cv2.resize(one, size, interpolation=cv2.INTER_AREA) for one in pair.color8))
    found = preset("stereo", "fast").pipeline(small, -(-top // 2)).disparity.values
    values = cv2.resize(found * np.float32(2), (width, height), interpolation=cv2.INTER_LINEAR)
    known = np.isfinite(truth.values) & (truth.values > 0) & np.isfinite(values)
    bound = given_maps.judge(networks(), pair, [values], top).bound
    assert np.mean(np.abs(values - truth.values)[known] <= bound[known]) > 0.85


def test_filled_values_are_less_sure(pair: StereoPair, scene: SyntheticScene):
    values, filled = scene.disparity_left, np.zeros(scene.disparity_left.shape, bool)
    filled[30:60, 50:90] = True
    (sure, low), (less, high) = (given_maps.bounds(networks(), pair, values, f, 32) for f in (np.False_, filled))
    assert (less[filled] < sure[filled]).all() and (high[filled] > low[filled]).all()
    np.testing.assert_array_equal(less[~filled], sure[~filled])
    np.testing.assert_array_equal(high[~filled], low[~filled])


def test_a_map_is_doubted_as_a_whole_where_it_contradicts_the_distinct_matches():
    alone, missing = np.zeros((len(_planes.ALONE), 40, 50), np.float32), np.zeros((40, 50), bool)
    peak, difference = (alone[_planes.ALONE.index(name)] for name in ("peak", "winner_difference"))
    judged = given_maps.Judged(alone[0], missing, alone, alone[:0])
    difference[:, :35] = 3
    assert given_maps.doubt(judged) == 0  # no match is distinct
    peak[:] = 1
    assert given_maps.doubt(judged) > 8
    missing[:, :30] = True  # of what is left, less than half
    assert given_maps.doubt(judged) == 0


def test_the_step_of_rounded_maps_is_found(scene: SyntheticScene):
    truth = scene.disparity_left
    assert given_maps.rounding_step(truth) == 0
    for step in (1, 0.5, 1 / 3, 0.25, 2):
        values = (np.rint(truth / step) * np.float32(step)).astype(np.float32)
        values[::37] = truth[::37]  # some are filled between the steps
        values[5:9] = np.nan
        assert given_maps.rounding_step(values) == pytest.approx(step, rel=1e-4)
    assert given_maps.rounding_step(np.full((20, 30), 7, np.float32)) == 1
    for unknown in (np.full((20, 30), 7.3, np.float32), np.full((20, 30), np.nan, np.float32), truth[0, :3]):
        assert given_maps.rounding_step(unknown) == 0


def test_bounds_of_rounded_maps_cover_what_rounding_adds(pair: StereoPair, scene: SyntheticScene):
    exact, values = scene.disparity_left, np.rint(scene.disparity_left)
    one_view = given_maps.judge_by_one_view(networks(), pair.left, values, 32)
    found = given_maps.judge(networks(), pair, [values], 32)
    for judgment in (found, one_view):
        assert np.mean(np.abs(values - exact) <= judgment.bound) > 0.85
    assert (found.bound >= 0.45).all() and np.median(found.bound) < 0.9
    assert (given_maps.judge(networks(), pair, [exact], 32).bound < 0.45).any()
    likely = given_maps.judge(networks(), pair, [values], 32, within=float(np.median(found.bound))).probability
    assert 0.88 < np.median(likely) < 0.99
