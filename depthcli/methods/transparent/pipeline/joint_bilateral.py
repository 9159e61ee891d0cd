"""Joint bilateral filling from sensor and samples, for comparison."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from depthcli.algorithms.filters import joint_bilateral_fill
from depthcli.core.context import Clock
from depthcli.core.frames import SparseFrame
from depthcli.core.method import Odd
from depthcli.core.result import DepthResult
from depthcli.methods.transparent.fitted_frame import inverse_depth, refined_depth
from depthcli.methods.transparent.pipeline import TransparentPipeline
from depthcli.methods.transparent.pipeline.nearest import NearestSample, nearest_depth


class JointBilateralFilling(TransparentPipeline):
    """Fill gaps and unreliable pixels with a mean of known values around, weighted by distance and color."""

    window: Odd = Field(21, ge=3, le=101, description="side of the window, pixels, odd")
    sigma_space: float = Field(5.0, gt=0, description="standard deviation of the weight by distance, pixels")
    sigma_color: float = Field(15.0, gt=0, description="standard deviation of the weight by color, grey levels")

    def __call__(self, frame: SparseFrame) -> DepthResult:
        clock = Clock()
        clock.start("fill")
        unreliable = NearestSample().unreliable(frame, nearest_depth(frame))
        reliable = np.where(unreliable, np.float32(np.nan), frame.depth)
        known = inverse_depth(np.where(np.isfinite(reliable), reliable, frame.sparse))
        filled = joint_bilateral_fill(frame.color, known, self.window, self.sigma_space, self.sigma_color)
        return refined_depth(frame, filled, unreliable, clock)

    def peak_bytes(self, shape: tuple[int, int]) -> int:
        return 160 * shape[0] * shape[1] + (16 << 20)
