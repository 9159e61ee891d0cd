"""The plane of each segment's disparities: parameters of the fit in a config."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.algorithms.plane_fitting.segment_planes import Members, Planes, fit_segment_planes
from depthcli.methods.stereo.segments import Step


class PlaneFit(Step):
    """RANSAC planes through the disparities of segments, refined by least squares over their inliers."""

    tolerance: float = Field(0.5, gt=0, le=16384, description="distance of a RANSAC inlier from the plane, pixels")
    trials: int = Field(200, ge=1, le=100_000, description="RANSAC samples a segment")
    max_slope: float = Field(1.0, ge=0, le=16, description="steepest plane, pixels of disparity a pixel")
    flatness: float = Field(
        1.0, ge=0, le=1, description="a sloping plane must bring the misfit below this part of a flat one's; 1: always"
    )  # fmt: skip
    seed: int = Field(0, ge=0, le=2**31 - 1, description="of the RANSAC samples, with the number of the segment")

    def __call__(self, values: NDArray[np.float32], members: Members, chosen: NDArray[np.int64]) -> Planes:
        """Fit one plane to each of the segments ``chosen`` (K,), none of them empty.

        Parameters
        ----------
        values : (H, W) float32 disparities, pixels
        members : the pixels to fit, by segment
        """
        return fit_segment_planes(
            values, members, chosen, self.tolerance, self.trials, self.max_slope, self.flatness, self.seed
        )

    def constant(self, values: NDArray[np.float32], members: Members, chosen: NDArray[np.int64]) -> Planes:
        """Return the plane of constant disparity, the median, of each of the segments ``chosen``."""
        return fit_segment_planes(values, members, chosen, self.tolerance, 0, 0.0, 0.0, self.seed)
