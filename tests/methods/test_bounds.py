"""Bounds of refined and of completed depth: coverage, what widens them, and what they are computed from."""

from dataclasses import replace

import numpy as np
import pytest

from depthcli.core.frames import RgbdFrame, SparseFrame
from depthcli.core.maps import DepthMap, DepthStatus
from depthcli.methods.kinect.bounds import INPUTS, depth_bounds, error_planes
from depthcli.methods.transparent.bounds import EVIDENCE, evidence, glass_bounds
from depthcli.problems.frames import glass_errors, kinect_errors
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


SHAPE = 90, 120


def frame_and_map() -> tuple[SparseFrame, DepthMap]:
    """Return a wall at 1 m with a gap on the left, and samples but for a region on the right."""
    rng, status = np.random.default_rng(0), np.zeros(SHAPE, np.uint8)
    sensor = (1 + 0.002 * rng.standard_normal(SHAPE)).astype(np.float32)
    sparse = np.where(rng.random(SHAPE) < 0.1, 1 + 0.008 * rng.standard_normal(SHAPE), np.nan).astype(np.float32)
    sparse[20:70, 70:] = np.nan
    status[30:60, 10:40] = DepthStatus.GAP_FILLED
    values = np.where(status > 0, np.float32(1), sensor)
    sensor[status > 0] = np.nan
    values[0, 0], status[0, 0] = np.nan, DepthStatus.EMPTY
    return SparseFrame(np.full((*SHAPE, 3), 90, np.uint8), sensor, sparse=sparse), DepthMap(values, status)


def test_evidence_by_hand():
    frame, found = frame_and_map()
    planes = dict(zip(EVIDENCE, evidence(frame, found), strict=True))
    sampled = np.isfinite(frame.sparse)
    assert np.isfinite(list(planes.values())).all()
    np.testing.assert_allclose(planes["distance"][sampled], np.log2(1 / 120), rtol=1e-6)
    assert planes["noise"][80, 60] == pytest.approx(np.log2(0.002) - 0.92, abs=0.5), "mean of logarithms"
    assert planes["gap"][45, 100] > 2 > 1 > np.median(planes["gap"][75:, :60])
    assert planes["border"][45, 25] == pytest.approx(np.log2(16 / 120), abs=0.1)
    nothing = replace(frame, sparse=np.full(SHAPE, np.nan, np.float32))
    assert np.isfinite(evidence(nothing, found)).all()


def test_bounds_are_wide_where_nothing_was_measured():
    frame, found = frame_and_map()

    def bounds(**changes):
        return glass_bounds(glass_errors(), replace(frame, **changes), found, 0.9, 0.03)

    bound, probability = bounds()
    around, unsampled = np.median(bound[72:90, :60]), np.median(bound[35:55, 90:120])
    assert around < 0.03 and unsampled > 5 * around
    blind, filled = np.isnan(frame.depth), np.s_[35:55, 15:35]
    wrong = np.where(blind & np.isfinite(frame.sparse), np.float32(0.8), frame.sparse)
    for wider, _ in (bounds(sparse=wrong), bounds(objects=blind)):
        assert np.median(wider[filled]) > 2 * np.median(bound[filled])
    assert np.isnan(bound[0, 0]) and probability[0, 0] == 0 and np.isfinite(bound[found.valid]).all()
