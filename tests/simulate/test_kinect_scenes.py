"""Simulated Kinect measurements."""

import itertools

import numpy as np
import pytest

from depthcli.simulate.depth_sensor import KinectSample, simulate_kinect
from depthcli.simulate.kinect_scenes import SEQUENCE_KINDS, make_kinect_scene, make_kinect_sequence
from tests.golden import refused
from tests.methods.kinect._made import same_points

GREY = np.full((60, 120, 3), 128, np.uint8)
BOX = np.full((60, 120), 10, np.float32)
BOX[:, 50:80] = 22


def simulated(truth: np.ndarray, **options) -> KinectSample:
    """What a sensor without noise measures."""
    return simulate_kinect(GREY[: len(truth)], truth, 0, noise=0.0, discs=0, **options)


@pytest.mark.parametrize(("left", "right", "sides"), [(0, 0, "both"), (4, 4, "both"), (2, 0, "left"), (0, 7, "right")])
def test_a_box_gets_wider_and_casts_a_shadow_as_wide_as_the_jump(left, right, sides):
    sample = simulated(BOX, fattening=max(left, right), sides=sides)
    columns = np.arange(120)
    wide = (columns >= 50 - left) & (columns < 80 + right)
    shadow = (columns >= 50 - left - 12) & (columns < 50 - left)
    for found, expected in (
        (sample.occluded, shadow),
        (sample.mismatch, wide & (BOX[0] == 10)),
        (sample.disparity, np.where(shadow, np.nan, np.where(wide, 22, 10))),
    ):
        np.testing.assert_array_equal(found, np.tile(expected, (60, 1)))
    np.testing.assert_array_equal(sample.measured, ~sample.occluded & ~sample.mismatch)
    assert not sample.specular.any()


def test_a_nearer_object_is_not_shadowed_by_a_farther_one():
    truth = np.full((40, 120), 10, np.float32)
    truth[:, 60:100] = 30  # its shadow reaches back to column 40 on what is at 10
    truth[:, 44:50] = 25
    sample = simulated(truth, fattening=0)
    # At 25 the shadow starts 5 pixels before the edge; that object's own shadow reaches back to column 29.
    expected = np.isin(np.arange(120), [*range(29, 44), *range(50, 60)])
    np.testing.assert_array_equal(sample.occluded, np.tile(expected, (40, 1)))


def test_pixels_beside_a_step_have_values_between_both_surfaces():
    disparity = simulated(BOX, mixed=2, fattening=0, shadows="none").disparity
    beside = np.isin(np.arange(120), [*range(48, 52), *range(78, 82)])
    np.testing.assert_array_equal(disparity[:, ~beside], BOX[:, ~beside])
    values = disparity[:, beside]
    assert values.min() >= 10 and values.max() <= 22 and values.mean() == pytest.approx(16, abs=1)


def test_noise_that_is_smooth_rounded_disparities_and_rows_without_truth():
    """White noise, smoothed by a Gaussian of 2 pixels: neighbors correlate by exp(-1 / 16)."""
    flat = np.full((200, 300), 40, np.float32)
    noise = simulate_kinect(np.zeros((200, 300, 3), np.uint8), flat, 0, noise=0.3, correlation=2.0, discs=0)
    error = noise.disparity - flat
    assert error.std() == pytest.approx(0.3, rel=0.05)
    assert np.corrcoef(error[:, 1:].ravel(), error[:, :-1].ravel())[0, 1] == pytest.approx(np.exp(-1 / 16), abs=0.02)
    truth = BOX + np.float32(0.2)
    np.testing.assert_array_equal(simulated(truth, step=0.25, fattening=0, shadows="none").disparity, BOX + 0.25)
    truth[:7] = np.nan
    near = simulated(truth, farthest=0.5, fattening=0, shadows="none").disparity
    expected = np.where(BOX == 22, truth, np.nan)  # only the box is nearer than half of the largest disparity
    np.testing.assert_array_equal(near, expected)
    refused(ValueError, simulate_kinect, GREY, np.full((60, 120), np.inf))


def test_slopes_are_no_edges():
    truth = np.tile(np.linspace(10, 60, 120, dtype=np.float32), (60, 1))
    sample = simulated(truth)
    assert sample.measured.all()
    np.testing.assert_array_equal(sample.disparity, truth)


def test_masks_part_the_known_pixels_and_noise_is_as_asked_for():
    color, truth = make_kinect_scene("foreground", 3)
    truth[20:40, 100:140] = np.nan
    before = truth.copy()
    sample = simulate_kinect(color, truth, 5)
    np.testing.assert_array_equal(truth, before)
    parts = np.stack([sample.occluded, sample.specular, sample.mismatch, sample.measured]).sum(axis=0)
    np.testing.assert_array_equal(parts, np.isfinite(truth))
    np.testing.assert_array_equal(sample.gap, np.isfinite(truth) & np.isnan(sample.disparity))
    assert min(mask.sum() for mask in (sample.occluded, sample.specular, sample.mismatch)) > 300
    error = (sample.disparity - sample.truth)[sample.measured]
    assert error.std() == pytest.approx(0.3, abs=0.01) and abs(error.mean()) < 0.01
    assert (sample.disparity - sample.truth)[sample.mismatch].min() > 1 - 5 * 0.3
    frame = sample.frame(50.0)
    np.testing.assert_allclose(frame.disparity, sample.disparity, rtol=1e-5)
    np.testing.assert_allclose(50.0 / sample.depth_true(50.0), truth, rtol=1e-5)


@pytest.mark.parametrize("kind", SEQUENCE_KINDS)
def test_sequences(kind):
    frames = make_kinect_sequence(kind, 4, 1, 200, 150, 30, speed=5)
    assert len(frames) == 4
    for first, second in itertools.pairwise(frames):
        moved = (first.truth != second.truth).mean()
        low, high = {"static": (-1, 0), "moving": (0.01, 0.3), "camera": (0.9, 1)}[kind]
        assert low < moved <= high
        assert np.mean(first.color != second.color) > 0.5
        same = first.measured & second.measured & (first.truth == second.truth)
        assert kind == "camera" or np.nanstd((first.disparity - second.disparity)[same]) > 0.3


def test_a_moving_camera_sees_the_same_points_from_its_poses():
    first, *_, last = make_kinect_sequence("camera", 6, 1, 200, 150, 30)
    index, seen = same_points(first, last, 0.05)
    assert seen.mean() > 0.8  # the others are hidden, or outside
    moved = np.hypot(*np.subtract(np.divmod(index, 200), np.divmod(np.arange(index.size), 200)))
    assert np.median(moved[seen]) > 3
