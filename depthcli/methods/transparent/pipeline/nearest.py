"""The nearest sample, smoothed, for comparison."""

from __future__ import annotations

from typing import ClassVar

import cv2
import numpy as np
from pydantic import Field

from depthcli.algorithms.nearest import nearest_points
from depthcli.algorithms.plane_fitting.sample_planes import Samples
from depthcli.core.context import Clock
from depthcli.core.frames import SparseFrame
from depthcli.core.maps import Floats, Mask
from depthcli.core.result import DepthResult
from depthcli.methods.transparent.fitted_frame import inverse_depth, refined_depth
from depthcli.methods.transparent.pipeline import TransparentPipeline


class NearestSample(TransparentPipeline):
    """Keep the sensor's depth if it is close to the nearest sample's depth, or if no sample is near.

    All other pixels take the depth of the nearest sample.
    """

    bytes_per_pixel: ClassVar[int] = 120

    tolerance: float = Field(0.015, ge=0, description="largest difference at which the sensor's value is kept, meters")
    relative_tolerance: float = Field(
        0.02, ge=0, description="the same as a share of the depth; the larger limit counts"
    )
    reach: float = Field(40.0, ge=0, description="distance of a sample that the sensor is compared with, pixels")

    def __call__(self, frame: SparseFrame) -> DepthResult:
        clock = Clock()
        clock.start("fill")
        dense = nearest_depth(frame)
        unreliable = self.unreliable(frame, dense)
        sensor = inverse_depth(frame.depth)
        values = np.where(np.isfinite(sensor) & ~unreliable, sensor, inverse_depth(dense))
        return refined_depth(frame, values, unreliable, clock)

    def unreliable(self, frame: SparseFrame, dense: Floats) -> Mask:
        """Select the pixels, (H, W) bool, whose sensor depth differs from ``dense`` near samples; median of 5 x 5."""
        distance = Samples.of(frame.sparse).distance(frame.shape)
        far = np.abs(dense - frame.depth) > np.maximum(self.tolerance, self.relative_tolerance * frame.depth)
        smooth = cv2.medianBlur((far & (distance <= self.reach)).astype(np.uint8), 5)
        return np.asarray((smooth > 0) & np.isfinite(frame.depth), np.bool_)


def nearest_depth(frame: SparseFrame) -> Floats:
    """Return the nearest sample's depth, median of 5 x 5, (H, W) float32, meters; NaN if there is no sample."""
    samples = Samples.of(frame.sparse)
    if samples.values.size == 0:
        return np.full(frame.shape, np.nan, np.float32)
    rows, columns = (axis.ravel().astype(np.int32) for axis in np.mgrid[: frame.shape[0], : frame.shape[1]])
    nearest = nearest_points(columns, rows, samples.columns, samples.rows, 1)
    return np.asarray(cv2.medianBlur(samples.values[nearest[:, 0]].reshape(frame.shape), 5), np.float32)
