"""Library filters for comparison, and the preset fast."""

import numpy as np
import pytest

from depthcli.core.context import Clock
from depthcli.core.frames import RgbdFrame
from depthcli.core.maps import DepthStatus
from depthcli.methods.kinect.disparity import nearest_fill, refined_depth
from tests.golden import refused
from tests.methods.kinect._made import off, pipeline, sample_of


def few_pixels(disparity):
    """A black frame of a disparity in pixels."""
    color = np.zeros((*disparity.shape, 3), np.uint8)
    return RgbdFrame(color, (43.5 / disparity).astype(np.float32))


FILLS = ("inpaint", {}), ("inpaint", {"algorithm": "navier-stokes"}), ("joint_bilateral", {}), ("nearest", {})


@pytest.mark.parametrize(("name", "fields"), FILLS)
def test_fills_keep_what_is_known(name, fields):
    frame = sample_of(seed=2, discs=4).frame()
    refined, known = pipeline(name, **fields)(frame).depth, ~np.isnan(frame.depth)
    np.testing.assert_array_equal(refined.values[known], frame.depth[known])
    assert (refined.status[known] == DepthStatus.KEPT).all()
    assert (refined.status[~known] == DepthStatus.GAP_FILLED).all()


def test_nearest_fill_takes_the_nearest_known_value():
    values = np.full((20, 20), np.nan, np.float32)
    values[3, 4], values[15, 12] = 1, 2
    filled = nearest_fill(values)
    rows, columns = np.mgrid[:20, :20]
    first, second = np.hypot(rows - 3, columns - 4), np.hypot(rows - 15, columns - 12)
    clear = np.abs(first - second) > 1  # the transform's distances are approximate
    np.testing.assert_array_equal(filled[clear], np.where(first < second, 1, 2)[clear])
    assert np.isnan(nearest_fill(np.full((3, 3), np.nan, np.float32))).all()


def test_the_status_of_refined_depth():
    """Measured 10 px, moved by less and by more than 3 deviations; gaps; a thousandth and less of what was measured."""
    depth = np.array([[1, 1, 1, 1, np.nan, np.nan, np.nan, np.nan]], np.float32)
    disparity = np.array([[10, 10.29, 10.31, np.nan, 5, 5, 0.05, 0.005]], np.float32)
    fallback = np.arange(8)[None] != 4
    frame = RgbdFrame(np.zeros((1, 8, 3), np.uint8), depth, 10.0)
    found = refined_depth(frame, disparity, 0.1, Clock(), fallback)
    names = ("KEPT", "SMOOTHED", "CORRECTED", "EMPTY", "GAP_FILLED", "FALLBACK", "FALLBACK", "EMPTY")
    assert [DepthStatus(bits).name for bits in found.depth.status[0]] == list(names)


def spatial(line, alpha, delta):
    """One pass over a line, there and back, with edges at steps of the unfiltered values."""
    for order in (range(len(line)), range(len(line) - 1, -1, -1)):
        source, state, before = line.copy(), np.nan, np.nan
        for i in order:
            if abs(before - source[i]) < delta:
                state = alpha * source[i] + (1 - alpha) * state
                line[i] = state
            else:
                state = source[i]
            before = source[i]
    return line


def test_realsense_spatial_filter():
    rng = np.random.default_rng(3)
    disparity = (20 + np.cumsum(rng.normal(0, 0.4, (13, 17)), axis=1)).astype(np.float32)
    disparity[rng.random((13, 17)) < 0.2] = np.nan
    method, frame = pipeline("realsense", temporal_alpha=1, persistency=0, hole_filling="off"), few_pixels(disparity)
    expected = frame.disparity.astype(float)
    for _ in range(2):
        expected = np.array([spatial(row, 0.5, 20 / 32) for row in expected])
        expected = np.array([spatial(column, 0.5, 20 / 32) for column in expected.T]).T
    np.testing.assert_allclose(43.5 / method(frame).depth.values, expected, rtol=1e-4)


def test_realsense_temporal_filter_smooths_carries_over_and_follows():
    method = pipeline("realsense", magnitude=0, hole_filling="off")
    # steady; seen twice, then gone for long; moves by more than the threshold
    columns = [[10, 10.4, 10, 10, 10, 10, 10], [10, 10] + [np.nan] * 5, [10, 12, 12, 12, 12, 12, 12]]
    state, seen, carried = None, [], []
    for disparity in np.array(columns).T:
        refined, state = method.step(few_pixels(disparity[None]), state)
        seen.append(43.5 / refined.depth.values[0])
        carried.append(bool(refined.depth.status[0, 1] & DepthStatus.CARRIED))
        assert refined.depth.filled[0, 1] == carried[-1]
    seen = np.array(seen)
    assert seen[1, 0] == pytest.approx(0.4 * 10.4 + 0.6 * 10, rel=1e-5)
    np.testing.assert_allclose(seen[:, 2], columns[2], rtol=1e-5)
    # valid in 2 of the last 4 frames: for three frames after the value is gone
    np.testing.assert_array_equal(np.isnan(seen[:, 1]), [False] * 5 + [True] * 2)
    assert carried == [False, False, True, True, True, False, False]
    refused(ValueError, method.step, few_pixels(np.ones((2, 3))), state)


@pytest.mark.parametrize(("mode", "value"), [("left", 10), ("farthest", 8), ("nearest", 14)])
def test_realsense_hole_filling(mode, value):
    disparity = np.full((3, 4), 10.0)
    disparity[0, 2], disparity[2, 1], disparity[1, 2] = 14, 8, np.nan
    refined = pipeline("realsense", magnitude=0, hole_filling=mode)(few_pixels(disparity))
    assert 43.5 / refined.depth.values[1, 2] == pytest.approx(value, rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["planes", "foreground", "curved", "camouflage"])
def test_shadow_smoother_has_smaller_errors_than_the_smoother_it_uses(kind):
    sample = sample_of(kind, size=(320, 240), discs=4)
    methods = pipeline("shadow_smoother"), pipeline("fast_global_smoother")
    ours, peer = (off(method(sample.frame()), sample) for method in methods)
    for part in (sample.gap, sample.mismatch):
        assert np.nanmean(ours[part]) < 0.8 * np.nanmean(peer[part])
    assert np.nanmean(ours[sample.measured]) < 0.24


def test_without_colors_the_edges_of_the_depth_stop_the_smoothing():
    truth = np.where(np.arange(60) < 30, 22, 12) + np.zeros((40, 1))
    disparity = truth + 0.2 * np.random.default_rng(0).standard_normal(truth.shape)
    disparity[10:30, 20:40] = np.nan
    frame = RgbdFrame.without_color((43.5 / disparity).astype(np.float32), 43.5, None)
    error = np.abs(43.5 / pipeline("shadow_smoother")(frame).depth.values - truth)
    assert error.mean() < 0.06 and error[:, 25:35].mean() < 0.12
