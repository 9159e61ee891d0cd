"""Depth edges, noise, models of segments, filled gaps and votes for planes: against slow references, and as wholes."""

import cv2
import numpy as np
import pytest

from depthcli.algorithms.plane_fitting.polynomials import Polynomial
from depthcli.algorithms.plane_fitting.window_planes import window_planes
from depthcli.core.frames import RgbdFrame
from depthcli.methods.kinect import gap_filling
from depthcli.methods.kinect.candidates import LEVELS, OPENING_LEVEL, ExtraVotes, Voters, cast_votes, hidden_openings
from depthcli.methods.kinect.depth_edges import MIN_OFFSET, near_side, outline_offsets
from depthcli.methods.kinect.disparity import noise_level
from depthcli.methods.kinect.gap_filling import fill_gaps
from depthcli.methods.kinect.gap_limits import GapLimits, max_disparity_in_gaps, shadow_background, shadow_limits
from depthcli.methods.kinect.layers import add_detail, join_segments
from depthcli.methods.kinect.shadows import Shadow, Shadows, measure_shadows
from depthcli.simulate.depth_sensor import simulate_kinect
from depthcli.simulate.kinect_scenes import make_kinect_scene
from tests.methods.kinect._made import blocks, labels_of, noisy, off, pipeline, random_planes, sample_of
from tests.naive import kinect as naive

SHAPES = [(1, 1), (1, 40), (40, 1), (9, 70), (31, 130)]


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("unknown", [0.0, 0.3, 1.0])
def test_max_disparity_in_gaps(shape, unknown):
    disparity = noisy(*shape, unknown=unknown)
    for shadow, p_hole in ((Shadow(1.0), 0.0), (Shadow(0.5, scale=0.7, covered=2.0), 0.0), (Shadow(1.0), 0.9)):
        for right in (False, True):
            shadows = Shadows(right=shadow, p_hole=p_hole) if right else Shadows(shadow, p_hole=p_hole)
            turn = np.s_[:, ::-1] if right else np.s_[:, :]
            found = max_disparity_in_gaps(np.ascontiguousarray(disparity[turn]), 1.5, shadows, 2.5)[turn]
            expected = naive.max_disparity_in_gaps(disparity, 1.5, 2.5, shadow.scale, shadow.covered, p_hole < 0.5)
            np.testing.assert_allclose(found, expected, rtol=1e-5)
    assert np.isinf(max_disparity_in_gaps(disparity, 1.5, Shadows(), 2.5)).all()


@pytest.mark.parametrize("seed", range(4))
def test_plane_by_huber(seed):
    rng, shape = np.random.default_rng(seed), (9, 10)
    places = np.mgrid[:9, :10].astype(float)
    values = (30 + 0.4 * places[1] - 0.2 * places[0] + 0.1 * rng.standard_normal(shape)).astype(np.float32)
    values[rng.random(shape) < 0.2] += 9
    values[rng.random(shape) < 0.2] = np.nan
    known = ~np.isnan(values)
    fitted = Polynomial(iterations=100)(values, np.zeros(shape, np.int32), 0.05)
    y, x = (places[:, known] - fitted.center[0][:, None]) / 10
    beta, scale = naive.huber_plane(values[known].astype(float), x, y, 1.345, 0.05)
    np.testing.assert_allclose(fitted.coefficients[0, :3], beta, atol=0.02)
    np.testing.assert_allclose(fitted.scale[0], scale, rtol=0.1)


@pytest.mark.parametrize(
    ("known", "degree", "expected"), [(20, 2, 0), (60, 2, 1), (60, 1, 1), (400, 2, 2), (400, 0, 0)]
)
def test_degree_follows_what_is_known(known, degree, expected):
    rows, columns = np.mgrid[:20, :20].astype(np.float32)
    values = 20 + 0.5 * columns + 0.3 * rows + 0.02 * columns * rows
    values.ravel()[np.random.default_rng(0).permutation(400)[known:]] = np.nan
    beta = Polynomial(degree=degree)(values, np.zeros((20, 20), np.int32), 0.01).coefficients[0]
    assert (beta[1:3] != 0).all() == (expected >= 1)
    assert (beta[3:] != 0).all() == (expected == 2)


def test_warm_start_follows_a_change_and_keeps_surfaces_without_known_pixels():
    columns = np.mgrid[:30, :60][1].astype(np.float32)
    labels = (columns >= 30).astype(np.int32)
    first = Polynomial()(20 + 0.2 * columns, labels, 0.1)
    moved = np.where(labels == 0, 20.6 + 0.2 * columns, np.nan).astype(np.float32)
    second = Polynomial()(moved, labels, 0.1, first)
    np.testing.assert_allclose(second.at(labels)[:, :30], moved[:, :30], atol=0.02)
    np.testing.assert_array_equal(second.coefficients[1], first.coefficients[1])
    assert second.scale[1] == first.scale[1]


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("reach", [0.8, 4.0])
@pytest.mark.parametrize("unknown", [0.0, 0.5, 1.0])
def test_detail(shape, reach, unknown):
    labels, known, surface = labels_of(*shape), noisy(*shape, unknown=unknown), np.full(shape, 22, np.float32)
    scale = np.random.default_rng(3).uniform(0.2, 2, labels.max() + 1).astype(np.float32)
    expected = naive.detail(surface.astype(float), known.astype(float), labels, scale, reach)
    add_detail(surface, known, labels, scale, reach)
    np.testing.assert_allclose(surface, expected, rtol=2e-5)


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (20, 31), (40, 45)])
@pytest.mark.parametrize("share", [0.0, 0.2, 0.6, 1.0])
@pytest.mark.parametrize("seed", [0, 1])
def test_segments_join(shape, share, seed):
    rng = np.random.default_rng(seed)
    labels = labels_of(*shape)
    count = labels.max() + 1
    modelled = rng.random(count) < share
    surfaces, value_at = random_planes(rng.uniform(10, 20, (count, 3)), np.ones(count, np.float32))
    limit = np.where(rng.random(shape) < 0.5, rng.uniform(10, 40, shape), np.inf).astype(np.float32)
    color = blocks(*shape, seed)
    found = join_segments(labels, modelled, surfaces, color, limit)
    np.testing.assert_array_equal(found, naive.owners(labels, modelled, color, value_at, limit))


@pytest.mark.parametrize("shape", [(1, 1), (1, 20), (20, 1), (7, 64), (9, 65), (30, 130), (2, 700), (700, 2)])
@pytest.mark.parametrize(("jump", "tolerance"), [(1.5, np.inf), (0.5, 0.4), (9.0, 2.5)])
@pytest.mark.parametrize("unknown", [0.0, 0.2, 0.8, 1.0])
def test_near_sides_agree_with_the_reference(shape, jump, tolerance, unknown):
    rng = np.random.default_rng(0)
    disparity = rng.integers(5, 9, shape).astype(np.float32)
    disparity[rng.random(shape) < unknown] = np.nan
    if max(shape) == 700:  # long runs
        disparity = np.sort(disparity, axis=None).reshape(shape)
        disparity[disparity.shape[0] // 2 :, disparity.shape[1] // 2 :] = 6
    copy = disparity.copy()
    row, column = naive.edge_distance(disparity.astype(float), jump, tolerance)
    for bands in ((1, 0), (0, 3), (5, 2), (64, 64)):
        expected = (row <= bands[0]) | (column <= bands[1])
        np.testing.assert_array_equal(near_side(disparity, jump, *bands, tolerance), expected)
    np.testing.assert_array_equal(disparity, copy)


@pytest.mark.parametrize("sigma", [0.2, 0.5, 1.0])
@pytest.mark.parametrize("shape", [(60, 80), (480, 640)])
def test_noise_on_a_slope_with_edges_and_gaps(sigma, shape):
    rng = np.random.default_rng(0)
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    values = 20 + 0.3 * columns + 0.1 * rows + 15 * (columns > shape[1] / 2) + sigma * rng.standard_normal(shape)
    values[rng.random(shape) < 0.2] = np.nan
    assert noise_level(values.astype(np.float32)) == pytest.approx(sigma, rel=0.08)


def test_the_noise_of_rounded_values_and_where_there_are_no_differences():
    values = np.tile(np.round((20 + 0.01 * np.arange(80)) / 0.5) * 0.5, (60, 1))
    assert noise_level(values.astype(np.float32)) == pytest.approx(0.5 / 12**0.5)
    for shape in ((1, 1), (1, 2), (2, 5)):
        assert noise_level(np.full(shape, np.nan, np.float32)) == 0.1
        assert noise_level(np.full(shape, 7, np.float32), floor=0.2) == 0.2


def some(shape, seed, unknown=0.7):
    rng = np.random.default_rng(seed)
    values = np.rint(10 + 20 * rng.random(shape)).astype(np.float32)
    values[cv2.GaussianBlur(rng.random(shape), (0, 0), 2) > np.quantile(rng.random(shape), 0.5)] = np.nan
    values[rng.random(shape) < unknown] = np.nan
    lab = cv2.GaussianBlur(rng.integers(0, 256, (*shape, 3)).astype(np.uint8), (0, 0), 3)
    segments = (np.mgrid[: shape[0], : shape[1]][1] // 9)[None].astype(np.int32)
    limit = np.where(rng.random(shape) < 0.3, 20, np.inf).astype(np.float32)
    return values, lab, segments, limit, (5 * rng.random(shape)).astype(np.float32)


@pytest.mark.parametrize("shape", [(1, 30), (30, 1), (17, 23), (40, 50)])
@pytest.mark.parametrize("seed", range(3))
def test_values_are_those_at_the_start_of_the_cheapest_path_and_smoothed(shape, seed, monkeypatch):
    values, lab, segments, limit, cost = some(shape, seed)
    values[0, 0] = 5
    smoothed, _ = fill_gaps(values, lab, segments, limit, cost, None)
    monkeypatch.setattr(gap_filling, "_SMOOTHING_STRIDES", ())
    filled, _ = fill_gaps(values, lab, segments, limit, cost, None)
    _, expected = naive.cheapest_paths(lab, segments, limit, values, cost)
    assert (filled == expected).mean() > 0.95  # the sweeps miss paths that wind
    known = ~np.isnan(values)
    np.testing.assert_array_equal(filled[known], values[known])
    expected = naive.smoothed_gaps(filled, known, lab, limit, (12, 8, 6, 4, 3, 2, 1), 35)
    np.testing.assert_array_equal(smoothed, expected)
    assert (smoothed <= limit)[~known].sum() >= (filled <= limit)[~known].sum()


def test_planes_continue_and_fade():
    truth = 20 + np.float32(0.2) * np.mgrid[:40, :80][1].astype(np.float32)
    values = truth.copy()
    values[5:35, 30:60] = np.nan
    grey, nothing = np.full((40, 80, 3), 90, np.uint8), np.zeros_like(values)
    filled, inside = fill_gaps(values, grey, np.empty((0, 40, 80), np.int32), nothing + np.inf, nothing, 0.1)
    assert np.abs(filled - truth).max() < 1.2
    assert np.abs(filled - truth).mean() < 0.1 * np.nanstd(truth)
    np.testing.assert_allclose(filled[6, 40:50], truth[6, 40:50], atol=0.05)
    assert not inside.any()
    _, inside = fill_gaps(values, grey, np.zeros((1, 40, 80), np.int32), nothing + np.inf, nothing, 0.1)
    np.testing.assert_array_equal(inside, np.isnan(values))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "ratio"), [("plane_votes", 0.8), ("dsrm", 0.8), ("shadow_smoother", 1.2)])
@pytest.mark.parametrize("kind", ["planes", "foreground", "curved"])
def test_holes_in_a_frame_without_shadows_are_filled_better_than_by_the_nearest_value(name, ratio, kind):
    color, truth = make_kinect_scene(kind, 3, 320, 240, 40)
    rng = np.random.default_rng(0)
    measured = truth + 0.2 * rng.standard_normal(truth.shape, np.float32)
    holes = np.zeros(truth.shape, bool)
    for _ in range(20):
        y, x = rng.integers(0, 210), rng.integers(0, 285)
        holes[y : y + 30, x : x + 35] = True
    frame = RgbdFrame(color, (43.5 / np.where(holes, np.nan, measured)).astype(np.float32))
    error, nearest = (
        np.abs(43.5 / pipeline(each)(frame).depth.values - truth)[holes].mean() for each in (name, "nearest")
    )
    assert error < ratio * nearest


def test_where_shadows_lie_can_be_set():
    sample, errors = sample_of(size=(320, 240), shadows="right"), {}
    for where in (True, "right", "left", False):
        result = pipeline("dsrm", shadows=where)(sample.frame())
        errors[where] = off(result, sample)[sample.occluded].mean()
        assert set(result.figures) == {"shadows_left", "shadows_right", "shadow_width_left", "shadow_width_right"}
    assert errors["right"] == pytest.approx(errors[True], rel=0.2)
    assert errors[True] < 0.7 * errors["left"] and errors[True] < 0.7 * errors[False]


def lab_of(color):
    return np.asarray(cv2.cvtColor(color, cv2.COLOR_RGB2LAB), np.uint8)


def large(kind="foreground", seed=0, size=(400, 300), **options):
    return sample_of(kind, seed, size, 32, **{"discs": 3, "disc_radius": (6.0, 12.0), **options})


PARTS = ("value", "slope_x", "slope_y", "scale")


def random_map(rng, shape, holes=0.15):
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    disparity = 20 + 0.1 * columns - 0.05 * rows + 0.3 * rng.standard_normal(shape)
    disparity[:, shape[1] // 2 :] += 9
    disparity[rng.random(shape) < holes] = np.nan
    return disparity.astype(np.float32)


@pytest.mark.parametrize("shape", [(23, 31), (1, 40), (40, 1), (5, 4), (1, 1)])
def test_window_planes_agree_with_the_reference(shape):
    rng = np.random.default_rng(sum(shape))
    disparity = random_map(rng, shape)
    trust = np.where(rng.random(shape) < 0.8, rng.random(shape), 0).astype(np.float32)
    planes = window_planes(disparity, trust, 0.3)
    np.testing.assert_array_equal(np.isnan(planes.value), np.isnan(disparity))
    for y, x in np.argwhere(~np.isnan(disparity)):
        window = np.s_[max(y - 4, 0) : y + 5, max(x - 4, 0) : x + 5]
        if trust[window][~np.isnan(disparity[window])].sum() < 0.5:
            continue
        mine = [getattr(planes, name)[y, x] for name in PARTS]
        np.testing.assert_allclose(mine, naive.local_plane(disparity, trust, 0.3, y, x), atol=6e-3)


def test_planes_whose_windows_did_not_change_are_taken_over():
    disparity, trust = random_map(np.random.default_rng(8), (40, 150)), np.ones((40, 150), np.float32)
    first = window_planes(disparity, trust, 0.3)
    changed = np.zeros((40, 150), bool)
    changed[20:23, 70:75] = True
    other = np.where(changed, np.float32(25), disparity)
    again, anew = window_planes(other, trust, 0.3, first, changed), window_planes(other, trust, 0.3)
    for name in PARTS:
        np.testing.assert_array_equal(getattr(again, name), getattr(anew, name))
    np.testing.assert_array_equal(first.value, window_planes(disparity, trust, 0.3).value)


def test_votes_agree_with_the_reference():
    rng, shape = np.random.default_rng(5), (43, 90)
    lab = rng.integers(60, 160, (*shape, 3), dtype=np.uint8)
    disparity = random_map(rng, shape)
    trust = np.where(np.isnan(disparity), 0, rng.random(shape)).astype(np.float32)
    planes = window_planes(disparity, trust, 0.3)
    limit = np.where(rng.random(shape) < 0.5, 25, np.inf).astype(np.float32)
    beyond = np.full(shape, 0.1, np.float32)
    voters = [Voters.of(lab, planes, trust, stride) for stride, _ in LEVELS]
    sigma = np.full(shape, 2 * 1.1**24, np.float32)  # one of those that there are tables for
    pixels = np.argwhere(rng.random(shape) < 0.01).astype(np.int32)
    added, bonus = np.full((3, *shape), np.nan, np.float32), np.array([0.3, 0.2, 0.2], np.float32)
    added[0, ::2], added[1, :, ::2], added[2, :, ::3] = 23.3, 21.7, 19.3
    extra = ExtraVotes(added, np.broadcast_to(bonus[:, None, None], added.shape).copy())
    values, shares = cast_votes(pixels, lab, voters, GapLimits(limit, beyond), extra, 0.3, 4, 40.0, sigma)
    voting = planes.value[(trust > 0) & ~np.isnan(planes.value)]
    agree, unit = 0, 0.3 * 5 / 3
    low = float(voting.min()) - 8 * unit
    bins = int((float(voting.max()) - low) / unit) + 10
    parts = (planes.value, planes.slope_x, planes.slope_y)
    for n, pixel in enumerate(pixels):
        mass, moment = naive.histogram(pixel, lab, parts, trust, limit, beyond, low, unit, bins, 40.0, 2 * 1.1**24)
        extras = added[:, pixel[0], pixel[1]]
        for value, vote in zip(extras, bonus * mass.sum(), strict=True):
            if not np.isnan(value):
                mass[int((value - low) / unit)] += vote
                moment[int((value - low) / unit)] += vote * value
        expected = naive.modes(mass, moment, 4)
        mine = [(v, s) for v, s in zip(values[n], shares[n], strict=True) if not np.isnan(v)]
        agree += len(mine) == len(expected) and np.allclose(mine, expected, atol=0.02)
    assert agree >= 0.95 * len(pixels)  # a vote at the border of two bins may fall into either


@pytest.mark.slow
@pytest.mark.parametrize("fattening", [2, 4, 6])
def test_outline_offsets_are_the_simulated_fattening(fattening):
    sample = large(fattening=fattening)
    distributions = outline_offsets(lab_of(sample.color), sample.disparity, 1.5)
    np.testing.assert_allclose(distributions.sum(axis=1), 1)
    for distribution in distributions:
        assert abs((distribution * np.arange(MIN_OFFSET, MIN_OFFSET + distribution.size)).sum() - fattening) < 1.2
        assert abs(MIN_OFFSET + distribution.argmax() - fattening) <= 1


def test_shadows_are_measured_on_both_sides():
    sample = large(discs=0)
    found = measure_shadows(sample.disparity, 1.5)
    assert (found.left.scale, found.left.covered) == (1, 0)
    assert found.left.confidence > 0.7 > 0.25 > found.right.confidence
    mirrored = measure_shadows(np.ascontiguousarray(sample.disparity[:, ::-1]), 1.5)
    assert (mirrored.right, mirrored.left) == (found.left, found.right)
    many = measure_shadows(np.tile(sample.disparity, (9, 1)), 1.5)  # of which only some gaps are looked at
    assert many.left.confidence > 0.7 and many.left.scale == 1 and many.right.confidence < 0.25


@pytest.mark.parametrize(("baseline", "covered"), [(0.5, False), (0.7, False), (1.4, False), (1.0, True)])
def test_the_width_of_shadows_is_measured(baseline, covered):
    sample = large(discs=0, baseline=baseline, covered=covered)
    shadow = measure_shadows(sample.disparity, 1.5).left
    assert shadow.confidence > 0.4
    step = np.median(np.diff(sample.truth)[np.diff(sample.truth) > 2])
    assert shadow.scale * step - shadow.covered == pytest.approx(baseline * step - 4 * covered, abs=2.0)


def test_limits_and_rims_of_shadows():
    columns = np.arange(120)
    truth = np.tile(np.where((columns >= 60) & (columns < 90), np.float32(22), np.float32(10)), (30, 1))
    sample = simulate_kinect(np.full((30, 120, 3), 90, np.uint8), truth, 0, noise=0.0, discs=0)
    planes = window_planes(sample.disparity, np.ones_like(truth), 0.1)
    maps = lab_of(sample.color), sample.disparity
    limit, beyond = shadow_limits(*maps, planes, 1.0, 0.3, Shadows(Shadow(1.0)))
    rim, bonus = shadow_background(sample.disparity, planes, 1.0, Shadows(Shadow(1.0)))
    gaps = np.isnan(sample.disparity)
    np.testing.assert_array_equal(gaps, np.tile((columns >= 44) & (columns < 56), (30, 1)))
    np.testing.assert_allclose(limit[:, 44:56], np.tile(22 - np.arange(12, 0, -1) + 0.3, (30, 1)), rtol=1e-5)
    np.testing.assert_allclose(rim[gaps], 10, atol=0.05)
    assert (bonus[gaps] > 0.5).all() and (beyond[gaps] < 0.05).all()
    assert np.isinf(limit[~gaps]).all() and (beyond[~gaps] == 1).all()
    assert (shadow_limits(*maps, planes, 1.0, 0.3, Shadows())[1] == 1).all()
    mirrored = [np.ascontiguousarray(each[:, ::-1]) for each in maps]
    right = Shadows(right=Shadow(1.0))
    turned = window_planes(mirrored[1], np.ones_like(truth), 0.1)
    np.testing.assert_allclose(shadow_limits(*mirrored, turned, 1.0, 0.3, right)[0][:, ::-1], limit, rtol=1e-5)
    np.testing.assert_allclose(shadow_background(mirrored[1], turned, 1.0, right)[0][:, ::-1], rim, atol=1e-4)


def test_an_opening_closed_by_the_sensor_is_found_by_its_color():
    opening, behind = np.zeros((2, 80, 160), bool)
    opening[30:50, 66:72] = True  # narrower than twice the fattening
    behind[:] = opening | (np.arange(160) < 50)
    color = np.where(behind[..., None], (60, 90, 200), (200, 60, 60)).astype(np.uint8)
    sample = simulate_kinect(color, np.where(behind, np.float32(22), np.float32(30)), 0, discs=0)
    assert sample.mismatch[opening].all()
    trust = np.isfinite(sample.disparity).astype(np.float32)
    planes = window_planes(sample.disparity, trust, 0.3)
    lab = lab_of(color)
    near = np.isfinite(sample.disparity) & (np.arange(160) > 58)
    hidden = hidden_openings(lab, planes, Voters.of(lab, planes, trust, LEVELS[OPENING_LEVEL][0]), near, 1.5, 11.0)
    assert hidden[opening].all()
    assert hidden[near & ~cv2.dilate(opening.astype(np.uint8), np.ones((9, 9))).astype(bool)].mean() < 0.01
    refined = pipeline("plane_votes")(sample.frame())
    assert np.median(43.5 / refined.depth.values[opening]) == pytest.approx(22, abs=0.5)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["planes", "foreground", "curved", "camouflage"])
def test_errors_are_below_those_of_library_filters_everywhere(kind):
    sample = large(kind, 1, (320, 240))
    frame = sample.frame()
    refined = pipeline("plane_votes")(frame)
    error, raw = off(refined, sample), np.abs(sample.disparity - sample.truth)
    assert refined.depth.density == 1
    assert error[sample.measured].mean() < 0.5 * raw[sample.measured].mean()
    assert error[sample.mismatch].mean() < 0.4 * raw[sample.mismatch].mean()
    for peer in map(pipeline, ("joint_bilateral", "fast_global_smoother")):
        other = off(peer(frame), sample)
        assert error[sample.gap].mean() < 0.5 * other[sample.gap].mean()
        assert error[sample.mismatch].mean() < other[sample.mismatch].mean()
