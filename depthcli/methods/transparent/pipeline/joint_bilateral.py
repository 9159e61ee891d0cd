"""Joint bilateral filling from sensor and samples, for comparison."""

from __future__ import annotations

import numpy as np

from depthcli.algorithms.filters import JointBilateral
from depthcli.core.context import Clock
from depthcli.core.frames import SparseFrame
from depthcli.core.result import DepthResult
from depthcli.methods.transparent.fitted_frame import inverse_depth, refined_depth
from depthcli.methods.transparent.pipeline import TransparentPipeline
from depthcli.methods.transparent.pipeline.nearest import NearestSample, nearest_depth


class JointBilateralFilling(JointBilateral, TransparentPipeline):
    """Fill gaps and unreliable pixels with a mean of known values around, weighted by distance and color."""

    def __call__(self, frame: SparseFrame) -> DepthResult:
        clock = Clock()
        clock.start("fill")
        unreliable = NearestSample().unreliable(frame, nearest_depth(frame))
        reliable = np.where(unreliable, np.float32(np.nan), frame.depth)
        known = inverse_depth(np.where(np.isfinite(reliable), reliable, frame.sparse))
        return refined_depth(frame, self.fill(frame.color, known), unreliable, clock)
