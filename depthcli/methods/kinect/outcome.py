"""From a refined disparity map to the result in meters."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from depthcli.core.cameras.triangulation import depth_of_disparity
from depthcli.core.frames import RgbdFrame
from depthcli.core.maps import DepthMap, DepthStatus
from depthcli.core.result import Clock
from depthcli.methods.kinect.result import RefinedDepth


def measured_disparity(frame: RgbdFrame) -> NDArray[np.float32]:
    """(H, W) float32 pixels, NaN = unknown; ValueError where nothing is known."""
    disparity = frame.disparity
    if np.isnan(disparity).all():
        raise ValueError("no pixel of the frame has a depth")
    return disparity


def outcome(
    frame: RgbdFrame,
    disparity: NDArray[np.float32],
    sigma: NDArray[np.float32],
    noise: float,
    clock: Clock,
    fallback: NDArray[np.bool_] | None = None,
) -> RefinedDepth:
    """The result with its status: what was measured and what became of it.

    Parameters
    ----------
    frame : what was measured
    disparity : (H, W) float32 refined, pixels, NaN = none. Not positive, or behind 1000 times the farthest
        measurement, is none as well
    sigma : (H, W) float32, pixels, NaN = none
    noise : of the measurement, pixels: a measured value that moved by more than three times as much was
        ``CORRECTED``, by less ``SMOOTHED``
    clock : seconds so far
    fallback : (H, W) bool, where a filled value came from around instead of the model
    """
    measured = frame.disparity
    known = ~np.isnan(measured)
    least = np.nanmin(measured) * np.float32(1e-3)
    values = np.where(disparity > least, disparity, np.float32(np.nan))
    depth = depth_of_disparity(values, frame.fb)
    same = values == measured
    depth[same] = frame.depth[same]
    moved = np.abs(values - measured)
    status = np.zeros(frame.shape, np.uint8)
    status[known & ~same] = DepthStatus.SMOOTHED
    status[known & (moved > 3 * noise)] = DepthStatus.CORRECTED
    status[~known] = DepthStatus.GAP_FILLED
    if fallback is not None:
        status[~known & fallback] = DepthStatus.FALLBACK
    status[np.isnan(depth)] = DepthStatus.EMPTY
    meters: NDArray[np.float32] = (sigma * depth * depth / np.float32(frame.fb)).astype(np.float32)
    clock.stop("result")
    return RefinedDepth(seconds=clock.seconds, depth=DepthMap(depth, status), sigma=meters)
