"""Planes of maps against loops over single pixels, the network against numpy, and what the judgment is worth."""

import math
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from depthcli.core.context import Clock
from depthcli.core.frames import StereoPair
from depthcli.core.maps import Status
from depthcli.methods import given_maps
from depthcli.methods.given_maps import _planes
from depthcli.methods.given_maps.fusion import fuse
from depthcli.problems.map_checks import networks
from depthcli.simulate.stereo_scenes import SyntheticScene, make_scene
from tests.contracts.inputs import preset, views, wrong
from tests.golden import refused
from tests.scenes import real_pair, real_scenes


@pytest.fixture(scope="module")
def scene() -> SyntheticScene:
    return make_scene("planes", 3, 160, 120, 32)


@pytest.fixture(scope="module")
def pair(scene: SyntheticScene) -> StereoPair:
    return views(scene)


@pytest.fixture(scope="module")
def evidence(pair: StereoPair) -> _planes.Evidence:
    return _planes.Evidence.of(pair, 32, Clock())


@pytest.fixture(scope="module")
def broken(scene: SyntheticScene) -> np.ndarray:
    """The truth with a wrong block and a gap."""
    values = scene.disparity_left.copy()
    values[40:70, 60:100] += 6
    values[90:100, 100:120] = np.nan
    return values


def test_planes_are_those_of_single_pixels(evidence: _planes.Evidence, broken: np.ndarray):
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
        others = [costs[y, x, d] for d in range(n) if abs(d - int(value + 0.5)) > 1]
        margin = min(max(math.log((min(others, default=65535) + 2) / (here + 2)), -2), 2)
        excess = min(math.log((here + 2) / (costs[y, x, evidence.left[y, x]] + 2)), 2)
        for name, expected, slack in (("rank", rank, 1.5 / n), ("margin", margin, 2e-3), ("excess", excess, 2e-3)):
            assert judged.plane(name)[y, x] == pytest.approx(expected, abs=slack), name
        assert judged.plane("missing")[y, x] == np.isnan(broken[y, x])


def test_gaps_are_filled_and_differences_limited():
    values = np.full((40, 60), 0.25, np.float32)
    values[:, 30:], values[5:9, 40:44] = 40, np.nan
    whole, missing = given_maps.without_gaps(values, 64)
    assert np.array_equal(whole[~missing], values[~missing]) and np.isfinite(whole[missing]).all()
    planes = {name: np.empty(whole.shape, np.float32) for name in _planes.INPUTS}
    whole[20, 10] = 40  # alone, so that no median sees it
    _planes.shape_planes(whole, 64, planes)
    limits = {"mean_11": 6, "mean_25": 6, "median_5": 6, "median_21": 8}
    assert {name: planes[f"above_{name}"].max() for name in limits} == limits


def test_the_kernel_is_the_network(evidence: _planes.Evidence, broken: np.ndarray):
    known = networks()
    judged = given_maps.judged_maps(evidence, [broken, broken + 1])[0]
    (w1, _), (w2, b2), (w3, b3) = known.right.layers
    inputs = np.concatenate([judged.alone, judged.others]).reshape(len(known.right.mean), -1).T
    scaled = np.clip((inputs - known.right.mean) * known.right.scale, -4, 4)
    want = np.maximum(np.maximum(scaled @ w1 + known.right.layers[0][1][1], 0) @ w2 + b2, 0) @ w3 + b3
    np.testing.assert_allclose(given_maps.odds_of(known, judged, 1.0).ravel(), want[:, 0], rtol=1e-3, atol=2e-3)


def test_a_wider_limit_is_never_less_likely(evidence: _planes.Evidence, broken: np.ndarray):
    """At the thresholds, between them and beyond, of maps that no network has seen."""
    limits = sorted([*np.geomspace(0.25, 8, 23), 0.5, 1.0, 1.0001, 2**0.25, 2**0.5, 3.9999, 4.0])
    for values in (broken, np.random.default_rng(0).uniform(0, 32, broken.shape).astype(np.float32)):
        judged = given_maps.judged_maps(evidence, [values, broken])[0]
        odds = {limit: given_maps.odds_of(networks(), judged, limit) for limit in limits}
        steps = np.diff(np.stack([*odds.values()]), axis=0)
        assert (steps >= 0).all() and (steps > 0).any(axis=0).mean() > 0.95
        np.testing.assert_allclose(odds[2**0.25], (odds[1.0] + odds[2**0.5]) / 2, atol=1e-5)
        np.testing.assert_array_equal(odds[limits[-1]], odds[4.0])
        np.testing.assert_array_equal(odds[limits[0]], odds[0.5])


def test_pixels_beyond_the_right_image():
    values, right = np.array([[2, 0, 2, 3], [2, 0, 0, 0]], np.float32)[:, None]
    status = given_maps.with_reasons(values, values < 0, np.ones_like(values), values == 2)
    assert status.tolist() == [[Status.OUT_OF_RANGE, 0, Status.OCCLUDED, 0]]
    assert given_maps._left_right(SimpleNamespace(values=values), None, right).tolist() == [[-16, 0, 0, -1]]


def test_the_gradient_of_the_match_is_compared_along_the_row():
    left = np.random.default_rng(0).integers(0, 256, (7, 12)).astype(np.float32)
    seen = SimpleNamespace(grey=(left, np.roll(left, -3, axis=1)))
    found = given_maps._gradient(SimpleNamespace(values=np.full(left.shape, 3, np.float32)), seen, None)
    assert (found[:, 4:-1] == 0).all()
    slopes = cv2.Sobel(left, cv2.CV_32F, 1, 0)[2] / 8
    found = given_maps._gradient(SimpleNamespace(values=np.full(left.shape, 2.5, np.float32)), seen, None)
    between = [slopes[x] - (slopes[x] + slopes[x + 1]) / 2 for x in range(4, 10)]
    np.testing.assert_allclose(found[2, 4:10], -np.abs(between), rtol=1e-5)


def test_the_costs_are_those_of_the_preset_fast():
    fast, own = preset("stereo", "fast").pipeline, (_planes._COST, _planes._OPTIMIZATION, _planes._REFINEMENT)
    assert (fast.cost, fast.optimization, fast.refinement) == own


def test_one_map_has_no_relation_to_others(evidence: _planes.Evidence, broken: np.ndarray):
    assert not given_maps.judged_maps(evidence, [broken])[0].others.any()
    first, second = given_maps.judged_maps(evidence, [broken, np.where(np.isnan(broken), broken, broken + 3)])
    assert len(first.others) == len(_planes.OTHERS)
    for judged, name in ((first, "nearest_map"), (second, "above_middle")):
        assert judged.plane(name)[10, 80] == pytest.approx(3)
    refused(ValueError, given_maps.judged_maps, evidence, [broken[:, 1:]])


def test_wrong_pixels_are_doubted_and_hidden_ones_found(pair: StereoPair, scene: SyntheticScene, broken: np.ndarray):
    judgment = given_maps.judge(networks(), pair, [broken], 32, measures=given_maps.MEASURES)
    off = np.zeros(broken.shape, bool)
    off[42:68, 62:98] = True
    right = scene.nonocc & ~off & np.isfinite(broken)
    assert judgment.probability[off].mean() < 0.25 < 0.9 < judgment.probability[right].mean()
    assert (judgment.probability[np.isnan(broken)] == 0).all()
    assert (judgment.status[np.isnan(broken)] == Status.NO_DATA).all()
    hidden, true = (judgment.status & int(Status.OCCLUDED | Status.OUT_OF_RANGE)) != 0, ~scene.nonocc
    assert 2 * np.sum(hidden & true) / (hidden.sum() + true.sum()) > 0.7
    assert set(judgment.confidence) == set(given_maps.MEASURES)
    assert all(np.isfinite(values[np.isfinite(broken)]).all() for values in judgment.confidence.values())


@pytest.mark.parametrize("surfaces", [False, True])
def test_the_best_of_two_halves(pair: StereoPair, scene: SyntheticScene, surfaces: bool):
    upper, lower = scene.disparity_left.copy(), scene.disparity_left.copy()
    upper[:60] += 5
    lower[60:] -= 3
    best = fuse(networks(), pair, [upper, np.clip(lower, 0, None)], 32, surfaces=surfaces)
    assert wrong(best, scene) < 0.05 and np.isfinite(best.disparity.values).all()
    assert best.probability[scene.nonocc].mean() > 0.8
    status = best.disparity.status
    assert np.mean(status[scene.nonocc] == Status.MEASURED) > 0.8
    assert np.mean(status[~scene.nonocc] & (Status.OCCLUDED | Status.OUT_OF_RANGE) > 0) > 0.5


def test_without_a_right_image_only_the_shape_counts(pair: StereoPair, scene: SyntheticScene):
    values, judge = scene.disparity_left.copy(), given_maps.judge_by_one_view
    values[40:60, 60:90] += np.random.default_rng(0).normal(0, 4, (20, 30)).astype(np.float32)
    found = judge(networks(), pair.left, np.clip(values, 0, 32), 32, measures=["smoothness", "census"])
    assert found.probability[42:58, 62:88].mean() < found.probability[80:110, 20:140].mean() - 0.3
    assert set(found.confidence) == {"smoothness"}
    refused(ValueError, judge, networks(), pair.left, values[1:], 32)


def error_of(values: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The pixels with a value and a true one, and their errors."""
    known = np.isfinite(truth) & (truth > 0) & np.isfinite(values)
    return known, np.abs(values - truth)[known]


@pytest.mark.slow
def test_bounds_cover_what_they_promise():
    """Shares inside of bounds, more if it is not known how a map was made, and nearly none of contradicted maps."""
    for name, tolerance in (("", 0.13), ("Dolls", 0.08), ("Art", 0.08)):
        pair, truth, top = real_scenes("middlebury_2005")[name] if name else real_pair()
        values = preset("stereo", "fast").pipeline(pair, top).disparity.values
        known, error = error_of(values, truth.values)
        for level in (0.5, 0.9, 0.98):
            probability, bound = given_maps.bounds(networks(), pair, values, np.False_, top, level=level)
            given = given_maps.judge(networks(), pair, [values], top, level=level).bound
            inside, among_others = (np.mean(error <= each[known]) for each in (bound, given))
            assert inside == pytest.approx(level, abs=tolerance) and np.isfinite(bound).all()
            assert among_others > inside - 0.005
        assert probability[known].mean() == pytest.approx(np.mean(error <= 1), abs=0.05)
        for other in (np.zeros_like(values), np.nan_to_num(truth.values).astype(np.float32) / 16, values[::-1].copy()):
            judgment = given_maps.judge(networks(), pair, [other], top)
            assert judgment.probability[known].mean() < 0.1 and np.median(judgment.bound) > 8


def test_bounds_of_maps_computed_at_half_the_size():
    pair, truth, top = real_scenes("middlebury_2005")["Dolls"]
    height, width = pair.shape
    size = (width // 2, height // 2)
    small = StereoPair(*(cv2.resize(one, size, interpolation=cv2.INTER_AREA) for one in pair.color8))
    found = preset("stereo", "fast").pipeline(small, -(-top // 2)).disparity.values
    values = cv2.resize(found * np.float32(2), (width, height), interpolation=cv2.INTER_LINEAR)
    known, error = error_of(values, truth.values)
    assert np.mean(error <= given_maps.judge(networks(), pair, [values], top).bound[known]) > 0.85


def test_filled_values_are_less_sure(pair: StereoPair, scene: SyntheticScene):
    values, filled = scene.disparity_left, np.zeros(scene.disparity_left.shape, bool)
    filled[30:60, 50:90] = True
    (sure, low), (less, high) = (given_maps.bounds(networks(), pair, values, f, 32) for f in (np.False_, filled))
    for smaller, larger in ((less, sure), (low, high)):
        assert (smaller[filled] < larger[filled]).all()
        np.testing.assert_array_equal(smaller[~filled], larger[~filled])


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
    found = given_maps.judge(networks(), pair, [values], 32)
    for judgment in (found, given_maps.judge_by_one_view(networks(), pair.left, values, 32)):
        assert np.mean(np.abs(values - exact) <= judgment.bound) > 0.85
    assert (found.bound >= 0.45).all() and np.median(found.bound) < 0.9
    assert (given_maps.judge(networks(), pair, [exact], 32).bound < 0.45).any()
    likely = given_maps.judge(networks(), pair, [values], 32, within=float(np.median(found.bound))).probability
    assert 0.88 < np.median(likely) < 0.99
