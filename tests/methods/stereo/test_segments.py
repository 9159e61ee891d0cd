"""The segment-based pipeline: its kernels against naive references; generated and impossible pairs."""

import numpy as np
import pytest

from depthcli.algorithms.plane_fitting.segment_planes import SegmentPlaneFit, SegmentPlanes
from depthcli.algorithms.regions import RegionPixels, region_graph
from depthcli.core.frames import StereoPair
from depthcli.core.maps import Status
from depthcli.io.formats.disparity import read_pfm
from depthcli.kernels.jit import run_bands
from depthcli.methods.stereo.keypoint_matching import Matches, consistent
from depthcli.methods.stereo.segments import planes as energy
from depthcli.methods.stereo.segments.first_estimate import FirstEstimate, Selection, Split, grid_parts, segment_window
from depthcli.methods.stereo.segments.ranges import Ranges, SearchRanges
from depthcli.methods.stereo.segments.steps import Restoration, _lines, map_with_status
from depthcli.methods.stereo.volume import CostVolume
from depthcli.problems.results import write_details
from depthcli.simulate.stereo_scenes import make_scene
from tests.contracts.checks import pairs_of_any_size_have_values_within_the_range_or_a_reason
from tests.contracts.inputs import part, preset, views, wrong
from tests.naive import segments as naive

FIT = SegmentPlaneFit(tolerance=0.5, trials=200, max_slope=1.0, flatness=1.0, seed=0)


def _preset(name="segments", **changes):
    return preset("stereo", name).pipeline.model_copy(update=changes)


def _labels(seed=0, shape=(9, 12), count=4):
    return np.random.default_rng(seed).integers(0, count, shape).astype(np.int32)


def _matches(*points):
    x, y, d = np.array(points, np.float32).reshape(-1, 3).T
    index = np.arange(len(x), dtype=np.int32)
    return Matches(index, index, x, y, d, np.zeros(len(x), np.float32))


@pytest.mark.parametrize("radius", [0, 1, 3, 12])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_window_stays_inside_the_segment(radius, dtype):
    costs = np.random.default_rng(radius).integers(0, 200, (9, 12, 5)).astype(dtype)
    costs[0, 0, 0] = 255
    volume = segment_window(CostVolume(costs, 2.0), _labels(), radius)
    expected = naive.segment_window(costs.astype(np.float64), _labels(), radius)
    step = 16 if dtype == np.uint8 else volume.scale / 2.0
    assert volume.costs.dtype == np.uint16
    assert np.allclose(volume.costs / step, expected, atol=0.6 / step + (0 if dtype != np.float32 else 0.05))


def test_ranges_follow_equations_2_3_to_2_5():
    labels = np.tile(np.arange(9, dtype=np.int32) // 3, (4, 1))
    some, one = _matches((0, 0, 10.2), (1, 1, 12.6), (4, 2, 1.0)), _matches((4, 2, 19.5))
    found = [Ranges(margin=m)(labels, each, 20).limits.tolist() for m, each in ((0.25, some), (0.25, None), (0, one))]
    assert found == [[[5, 18], [0, 6], [0, 20]], [[0, 20]] * 3, [[0, 20], [19, 20], [0, 20]]]
    near, far = _matches((2, 3, 5), (8, 0, 15)), Ranges(margin=0, neighbors=1, reach=3.0, cell=0)
    labels = np.tile(np.arange(12, dtype=np.int32) // 3, (4, 1))  # the second and the fourth have no key points
    assert far(labels, near, 20).limits.tolist() == [[5, 5], [5, 5], [15, 15], [15, 15]]


@pytest.mark.parametrize(("dtype", "limit"), [(np.uint8, 255), (np.uint16, 65535), (np.float32, np.inf)])
@pytest.mark.parametrize("penalty", [0.0, 20.0, 65535.0])
def test_disparities_outside_the_range_cost_more(dtype, limit, penalty):
    costs = np.random.default_rng(7).integers(0, 250, (9, 12, 6)).astype(dtype)
    ranges = np.array([[0, 5], [2, 3], [4, 5], [1, 1]], np.int32)
    raw = costs.copy()
    volume = Ranges(penalty=penalty).penalize(CostVolume(costs, 2.0), SearchRanges(_labels(), ranges))
    assert np.array_equal(costs, raw) and volume.costs.dtype == dtype
    (low, high), disparities = ranges[_labels()].transpose(2, 0, 1)[..., None], np.arange(6)
    outside = (low <= np.arange(12)[:, None]) & ((disparities < low) | (disparities > high))
    expected = np.where(outside, np.minimum(costs.astype(float) + 2 * penalty, limit), costs)
    assert np.array_equal(volume.costs, expected)


def test_key_points_that_disagree_with_their_neighbors_are_dropped():
    points = [(x, y, 5.0) for x in range(4) for y in range(4)]
    kept = consistent(_matches(*points, (1.5, 1.5, 12.0)), 2)
    assert len(kept) == 16 and kept.disparity.max() == 5
    assert len(consistent(_matches(), 2)) == 0


def test_ransac_finds_the_plane_among_outliers_and_any_order():
    rng, (y, x) = np.random.default_rng(1), np.mgrid[:30, :40]
    values = (0.1 * x - 0.05 * y + 7).astype(np.float32)
    wild = rng.random(values.shape) < 0.4
    values[wild] = rng.uniform(0, 20, wild.sum())
    halves = RegionPixels.of((x // 20).astype(np.int32))
    planes, backwards = (FIT(values, halves, np.array(order)) for order in ([0, 1], [1, 0]))
    assert np.allclose(planes.coefficients, [0.1, -0.05, 7], atol=0.02)
    assert np.all(planes.support >= 0.58 * 600)
    assert np.array_equal(backwards.coefficients[::-1], planes.coefficients)


def test_near_duplicates_are_dropped_and_represented():
    rows = np.array([(0, 0, 5), (0.001, 0, 5.1), (0, 0, 9), (0.5, 0, 5)])
    planes = SegmentPlanes(rows, np.arange(4, 0, -1), np.zeros((4, 2)))
    kept, stands_for = planes.distinct(0.01, 0.25, 10)
    assert kept.coefficients.tolist() == [[0, 0, 5], [0, 0, 9], [0.5, 0, 5]]
    assert stands_for.tolist() == [0, 0, 1, 2]
    assert planes.distinct(0.01, 0.25, 1)[1].tolist() == [0, 0, -1, -1]


TRUSTED = (np.random.default_rng(3).random((9, 12)) < 0.6) & (_labels() != 3)
ROWS = [(0.1, 0.0, 2.0), (0.0, 0.2, 1.0), (0.0, 0.0, 9.0)]
MEMBERS = RegionPixels.of(_labels(), TRUSTED, 4)


@pytest.mark.parametrize("truncation", [np.inf, 1.5])
@pytest.mark.parametrize("weighted", [False, True])
def test_discrepancy_is_equation_2_9(truncation, weighted):
    rng, unary = np.random.default_rng(3), np.zeros((4, 3))
    values = rng.uniform(0, 6, (9, 12)).astype(np.float32)
    weights = rng.uniform(0.2, 1, (9, 12)).astype(np.float32) if weighted else np.ones((1, 1), np.float32)
    run_bands(energy.discrepancy, 64, unary, values, weights, *MEMBERS, np.array(ROWS), 10.0, min(truncation, 1e6))
    expected = naive.discrepancy(values, TRUSTED, _labels(), ROWS, 10.0, truncation, np.broadcast_to(weights, (9, 12)))
    assert np.allclose(unary, expected, rtol=1e-4)
    assert np.all(unary[3] == 0)  # nothing trusted: any plane


def test_pixels_without_a_clear_winner_weigh_less():
    costs = np.full((1, 30, 6), 50, np.uint8)
    costs[0, :, 4] = 10
    costs[0, 27, [0, 3, 5]] = 10, 11, 12  # another one elsewhere is as cheap; neighbors do not count
    costs[0, 28, 0] = 30
    assert Selection(least_weight=0.5)(CostVolume(costs)).weights[0, 26:].tolist() == [1, 0.5, 0.75, 1]
    assert Selection()(CostVolume(costs)).weights is None
    assert set(Selection(least_weight=0.5)(CostVolume(costs[..., :2].copy())).weights[0]) == {np.float32(0.5)}


@pytest.mark.parametrize("with_agreement", [False, True])
def test_matching_cost_sums_the_volume(with_agreement):
    rng, unary = np.random.default_rng(4), np.ones((4, 3))
    costs = rng.integers(0, 200, (9, 12, 6)).astype(np.uint8)
    values = rng.integers(0, 6, (9, 12)).astype(np.float32) if with_agreement else np.empty((0, 0), np.float32)
    expected = naive.matching_cost(costs, TRUSTED, _labels(), ROWS, values if with_agreement else None)
    run_bands(energy.matching_cost, 64, unary, costs, values, *MEMBERS, np.array(ROWS), 1.5)
    assert np.allclose(unary, 1 + expected * 1.5)


def test_visibility_charges_planes_in_front_of_what_the_right_view_sees():
    limits = np.full((1, 12), 4, np.float32)  # the right view's disparities and one pixel, with a column beyond
    limits[:, [0, -1]] = np.inf
    members, unary = RegionPixels.of(np.zeros((1, 10), np.int32), np.arange(10)[None] >= 6), np.zeros((1, 4))
    planes = np.array([(0, 0, 3), (0, 0, 4), (0, 0, 5), (0, 0, 9.0)])
    run_bands(energy.visibility, 64, unary, limits, *members, planes, 2.0)
    assert unary.tolist() == [[0, 0, 8, 2]]  # at 9 only x = 9 points into the right image


def test_smoothness_is_equation_2_12():
    labels = np.tile(np.arange(6, dtype=np.int32) // 3, (4, 1))
    graph = region_graph(labels, np.where(labels[..., None] == 1, 10, 40).astype(np.uint8).repeat(3, axis=2))
    for name, fields, exponent in (
        ("gaussian", {}, 3 * 30**2 / 150**2), ("gaussian", {"color": "grey", "color_scale": 60}, 30**2 / 60**2),
        ("exponential", {}, 3**0.5 * 30 / 150),
    ):  # fmt: skip
        costs = part("methods.stereo.boundary", name, **fields)(graph)
        assert costs.tolist() == pytest.approx([4 * np.exp(-exponent)]), name


@pytest.mark.parametrize("cut", [[True] * 4, [False] * 4, [False, True, True, False]])
def test_a_grid_cuts_segments_into_parts(cut):
    labels = _labels()
    parts, count = grid_parts(labels, 5, np.array(cut))
    y, x = np.indices(labels.shape)
    whole = ~np.array(cut)[labels]
    cells = np.where(whole, 0, 3 * (y // 5) + x // 5)
    pairs = {*zip(labels.ravel().tolist(), cells.ravel().tolist(), parts.ravel().tolist(), strict=True)}
    assert len(pairs) == len(np.unique(parts)) == len({pair[:2] for pair in pairs})
    assert parts.max() < count and np.array_equal(parts[whole], labels[whole])


def test_only_segments_that_are_not_a_plane_are_cut():
    x = np.mgrid[:64, :128][1]
    values = np.where(x < 64, 5 + 0.1 * x, 10 + 8 * np.sin(x / 12)).astype(np.float32)
    labels = (x >= 64).astype(np.int32)
    first = FirstEstimate(values, np.ones((64, 128), bool), np.zeros((64, 128), np.uint16))
    cut = Split(cells=(16,), tolerance=0.5)(labels, first, FIT)
    left, right = (set(np.unique(half)) for half in (cut[:, :64], cut[:, 64:]))
    assert (len(left), len(right)) == (1, 16) and not left & right
    assert np.array_equal(naive.components(cut[..., None], 0).max(), cut.max())


def test_areas_off_their_plane_get_their_first_disparities_back_if_dense_smooth_and_wide():
    first = np.full((60, 100), 10.3)
    bump, strip, noise, blind = np.s_[20:40, 15:35], np.s_[:, 50:51], np.s_[20:40, 60:78], np.s_[45:57, 15:35]
    first[bump] = first[strip] = first[blind] = 14.3
    first[noise] = np.where(np.random.default_rng(0).random((20, 18)) < 0.5, 14.3, 10.3)
    costs = np.square(first[..., None] - np.arange(20)).astype(np.float32)
    costs[:, :, :2] += 1000  # as in a match outside the right image
    volume, trusted = CostVolume(costs, 1.0), np.ones(first.shape, bool)
    found = Selection()(volume)
    trusted[blind] = False
    given = FirstEstimate(found.values, trusted, found.right)
    planes = np.full(first.shape, 10, np.float32)
    np.testing.assert_array_equal(Restoration()(planes, given, volume), planes)
    restored = Restoration(radius=1)(planes, given, volume)
    np.testing.assert_allclose(restored[25:35, 20:30], 14.3, atol=0.05)  # with fractions
    for place in (strip, noise, blind, np.s_[:, 85:]):
        np.testing.assert_array_equal(restored[place], 10)


def test_the_status_of_planes():
    values, right = np.ones((1, 5), np.float32), np.array([[0, 0, 1, 3, 0]], np.uint16)
    first = FirstEstimate(np.array([[1, 2, 2.5, 1, 1]], np.float32), np.array([[0, 1, 1, 0, 0]]) > 0, right)
    hidden, wrong_one = Status.OCCLUDED | Status.FILLED, Status.MISMATCH | Status.FILLED
    assert map_with_status(values, first).status.tolist() == [[hidden, Status.SMOOTHED, wrong_one, wrong_one, hidden]]


def test_generated_planes_come_out_with_details_on_request(tmp_path):
    scene = make_scene("planes", seed=1, height=150, width=200, max_disparity=20)
    assert not _preset()(views(scene), 20).tables
    result = _preset(details=True)(views(scene), 20)
    figures, tables, pictures, status = result.figures, result.tables, result.pictures, result.disparity.status
    assert wrong(result, scene) < 0.02 and result.disparity.density == 1
    assert figures["energy"] <= figures["energy_before"]
    assert figures["planes"] > 0 and figures["keypoints"] > 10
    assert not np.any((status & Status.FILLED == 0) & (status & (Status.OCCLUDED | Status.MISMATCH) != 0))
    hidden = (status & Status.OCCLUDED) != 0
    assert hidden[~scene.nonocc].mean() > 0.5 > hidden[scene.nonocc].mean()
    assert set(pictures) == {"segments", "segments_preview", "keypoints", "initial_disparity", "trusted"}
    count = figures["segments"]
    sizes = {"planes": figures["planes"], "segment_labels": count, "keypoints": figures["keypoints"]}
    assert {name: len(table) for name, table in tables.items()} == sizes
    assert sum(row["segments"] for row in tables["planes"]) == count == pictures["segments"].max() + 1
    assert pictures["segments"].dtype == np.uint16 and pictures["keypoints"].shape == (300, 200, 3)
    write_details(result, tmp_path)
    initial, trusted = read_pfm(tmp_path / "initial_disparity.pfm"), pictures["trusted"] == 255
    assert np.mean(np.abs(initial - scene.disparity_left)[trusted & scene.nonocc] <= 1) > 0.95
    assert trusted.mean() == pytest.approx(figures["trusted"])


def test_matches_are_lines_to_the_right_image_below():
    pair = StereoPair(*np.full((2, 20, 60, 3), 90, np.uint8))
    numbers = np.zeros(1, np.int64)
    matches = Matches(numbers, numbers, *(np.array([value], np.float32) for value in (40, 4, 30, 0)))
    drawn = (_lines(pair, matches) != 105).any(axis=2)  # 90 / 2 + 60
    assert all(drawn[y, x] for y, x in ((4, 40), (14, 25), (24, 10))) and drawn.mean() < 0.1


def test_a_uniform_image_has_no_values():
    result = _preset(details=True)(StereoPair(*np.full((2, 40, 60, 3), 90, np.uint8)), 8)
    assert result.figures["segments"] == 1 and result.figures["keypoints"] == 0
    assert np.isnan(result.disparity.values).all() and np.all(result.disparity.status & Status.NO_DATA)


@pytest.mark.parametrize("name", ["segments", "ch2-kp-dedc", "ch2-kp", "ch2-dedc", "ch2-baseline"])
def test_tiny_pairs_and_ranges_wider_than_the_image(name):
    pairs_of_any_size_have_values_within_the_range_or_a_reason(_preset(name))
