"""Joint bilateral filling from sensor and samples, as a peer."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from depthcli.algorithms.joint_bilateral import joint_bilateral_fill
from depthcli.core.frames import SparseFrame
from depthcli.core.method import Odd
from depthcli.core.result import Clock, RefinedDepth
from depthcli.methods.transparent.evidence import inverse, outcome
from depthcli.methods.transparent.pipeline import TransparentPipeline
from depthcli.methods.transparent.pipeline.nearest import Nearest, disagrees, nearest_depth


class JointBilateral(TransparentPipeline):
    """Where the sensor is unknown or far from the nearest sample: a mean of what is around, by distance and color."""

    window: Odd = Field(21, ge=3, le=101, description="side of the window, pixels, odd")
    sigma_space: float = Field(5.0, gt=0, description="standard deviation of the weight by distance, pixels")
    sigma_color: float = Field(15.0, gt=0, description="standard deviation of the weight by color, grey levels")

    def __call__(self, frame: SparseFrame) -> RefinedDepth:
        clock = Clock()
        rule = Nearest()
        suspect = disagrees(frame, nearest_depth(frame), rule.tolerance, rule.relative_tolerance, rule.reach)
        believed = np.where(suspect, np.float32(np.nan), frame.depth)
        known = inverse(np.where(np.isfinite(believed), believed, frame.sparse))
        filled = joint_bilateral_fill(frame.color, known, self.window, self.sigma_space, self.sigma_color)
        result = outcome(frame, filled, np.full(frame.shape, np.nan), suspect, np.isfinite(frame.sparse), clock)
        clock.stop("fill")
        return result

    def peak_bytes(self, shape: tuple[int, int]) -> int:
        """A few maps."""
        return 160 * shape[0] * shape[1] + (16 << 20)
