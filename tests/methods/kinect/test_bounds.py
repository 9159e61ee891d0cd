"""Bounds of refined depth: coverage on simulated frames, their order, meters, and large gaps."""

import numpy as np
import pytest

from depthcli.core.frames import RgbdFrame
from depthcli.core.maps import DepthMap, DepthStatus
from depthcli.methods.kinect.bounds import INPUTS, depth_bounds, error_planes
from depthcli.problems.frames import kinect_errors
from tests.contracts.inputs import preset
from tests.methods.kinect._made import sample_of


def bounds_of(frame: RgbdFrame, found: DepthMap):
    return depth_bounds(kinect_errors(), frame, found, 0.9, 0.03)


@pytest.mark.parametrize("name", ["dsrm", "nearest", "guided"])
def test_nine_of_ten_errors_are_within_the_bound(name):
    """On a frame of a sensor that no table was made of."""
    kinect = sample_of(seed=7, noise=0.35, fattening=3)
    frame = kinect.frame()
    found = preset("refine-kinect", name).pipeline(frame).depth
    bound, probability = bounds_of(frame, found)
    error = np.abs(found.values - kinect.depth_true())
    assert 0.8 < np.mean((error <= bound)[found.kept]) < 0.99
    assert np.mean((error <= bound)[found.filled]) > 0.7
    right, pixels = error <= 0.03, found.valid
    assert right[pixels & (probability > 0.8)].mean() > 0.75 > 0.5 > right[pixels & (probability < 0.3)].mean()
    surest = bound <= np.quantile(bound, 0.8)
    assert error[surest].mean() < 0.7 * error.mean()


def test_bounds_grow_into_large_gaps():
    disparity = 20 + 0.02 * np.arange(160) + 0.1 * np.random.default_rng(0).standard_normal((120, 160))
    disparity[20:100, 30:130] = np.nan
    color = np.random.default_rng(1).integers(90, 110, (120, 160, 3)).astype(np.uint8)
    frame = RgbdFrame(color, (43.5 / disparity).astype(np.float32))
    bound, _ = bounds_of(frame, preset("refine-kinect", "nearest").pipeline(frame).depth)
    kept, rim, middle = (np.median(part) for part in (bound[:15], bound[22:26, 40:120], bound[55:65, 70:90]))
    assert kept < rim < middle / 1.5


def test_pixels_without_a_value_and_frames_without_color():
    measured = np.full((40, 50), 2.0, np.float32)
    measured[:, 30:] = np.nan
    frame = RgbdFrame.without_color(measured, 43.5, None)
    found = DepthMap(measured, np.where(np.isnan(measured), np.uint8(DepthStatus.EMPTY), np.uint8(0)))
    bound, probability = bounds_of(frame, found)
    for empty in (np.isnan(bound), probability == 0):
        np.testing.assert_array_equal(empty, np.isnan(measured))
    planes, noise = error_planes(frame, found)
    assert planes.shape == (len(INPUTS), 40, 50) and np.isfinite(planes).all() and noise == pytest.approx(0.1)
