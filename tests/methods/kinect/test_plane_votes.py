"""The pipeline plane_votes, and the kernels behind it."""

import cv2
import numpy as np
import pytest

from depthcli.algorithms.plane_fitting.window_planes import window_planes
from depthcli.methods.kinect.candidates import LEVELS, OPENING_LEVEL, ExtraVotes, Voters, cast_votes, hidden_openings
from depthcli.methods.kinect.depth_edges import MIN_OFFSET, outline_offsets
from depthcli.methods.kinect.gap_limits import GapLimits, shadow_background, shadow_limits
from depthcli.methods.kinect.shadows import Shadow, Shadows, measure_shadows
from depthcli.simulate.depth_sensor import simulate_kinect
from tests.methods.kinect._made import off, pipeline, sample_of
from tests.naive import kinect as naive


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
