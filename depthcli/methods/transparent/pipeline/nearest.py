"""The nearest sample, smoothed: the strong baseline."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.algorithms.plane_fitting.sample_planes import Samples, nearest_samples
from depthcli.core.frames import SparseFrame
from depthcli.core.result import Clock, RefinedDepth
from depthcli.methods.transparent.evidence import inverse, outcome
from depthcli.methods.transparent.pipeline import TransparentPipeline


class Nearest(TransparentPipeline):
    """The sensor where it is near the nearest sample's depth, or far from any sample; that depth elsewhere."""

    tolerance: float = Field(0.015, ge=0, description="difference up to which the sensor is believed, meters")
    relative_tolerance: float = Field(0.02, ge=0, description="or this share of the depth, where that is more")
    reach: float = Field(40.0, ge=0, description="farthest sample that speaks against the sensor, pixels")

    def __call__(self, frame: SparseFrame) -> RefinedDepth:
        clock = Clock()
        dense = nearest_depth(frame)
        suspect = disagrees(frame, dense, self.tolerance, self.relative_tolerance, self.reach)
        sensor = inverse(frame.depth)
        values = np.where(np.isfinite(sensor) & ~suspect, sensor, inverse(dense))
        result = outcome(frame, values, np.full(frame.shape, np.nan), suspect, np.isfinite(frame.sparse), clock)
        clock.stop("fill")
        return result

    def peak_bytes(self, shape: tuple[int, int]) -> int:
        """A few maps."""
        return 120 * shape[0] * shape[1] + (16 << 20)


def nearest_depth(frame: SparseFrame) -> NDArray[np.float32]:
    """(H, W) float32, meters: depth of the nearest sample, median of 5 x 5; NaN without any sample."""
    samples = Samples.of(frame.sparse)
    if samples.values.size == 0:
        return np.full(frame.shape, np.nan, np.float32)
    rows, columns = (axis.ravel().astype(np.int32) for axis in np.mgrid[: frame.shape[0], : frame.shape[1]])
    found = nearest_samples(samples.rows, samples.columns, frame.shape, (rows, columns), 1)
    dense: NDArray[np.float32] = samples.values[found[:, 0]].reshape(frame.shape)
    return np.asarray(cv2.medianBlur(dense, 5), np.float32)


def disagrees(
    frame: SparseFrame, dense: NDArray[np.float32], tolerance: float, relative: float, reach: float
) -> NDArray[np.bool_]:
    """(H, W) bool: the sensor's depth is far from ``dense``; median of 5 x 5."""
    blank = np.where(np.isfinite(frame.sparse), np.uint8(0), np.uint8(1))
    away = cv2.distanceTransform(blank, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    far = np.abs(dense - frame.depth) > np.maximum(tolerance, relative * frame.depth)
    smooth = cv2.medianBlur((far & (away <= reach)).astype(np.uint8), 5)
    suspect: NDArray[np.bool_] = (smooth > 0) & np.isfinite(frame.depth)
    return suspect
