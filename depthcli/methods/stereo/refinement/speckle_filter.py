"""Removal of small regions of disparity."""

from __future__ import annotations

import cv2
import numpy as np
from pydantic import Field

from depthcli.core.maps import DisparityMap, Status
from depthcli.methods.stereo.refinement import Refinement, marked
from depthcli.methods.stereo.volume import RefinementContext

_MAX_STEPS = 16  # of a pixel, as in OpenCV's 16-bit disparities; fewer above 2000 disparities


class SpeckleFilter(Refinement):
    """Remove connected regions of similar disparity that are too small to be trusted (``cv2.filterSpeckles``)."""

    needs_costs = False

    size: int = Field(50, ge=1, le=10**8, description="connected regions of at most this many pixels are removed")
    step: float = Field(1.0, ge=0, le=64, description="largest disparity step within a connected region, pixels")

    def __call__(self, disparity: DisparityMap, context: RefinementContext) -> DisparityMap:
        valid = disparity.valid
        none = -32768
        steps = steps_of(context.volume.n_disparities)
        fixed = np.where(valid, np.round(np.nan_to_num(disparity.values) * steps), none).astype(np.int16)
        cv2.filterSpeckles(fixed, none, self.size, self.step * steps)
        removed = valid & (fixed == none)
        values = np.where(removed, np.float32(np.nan), disparity.values)
        return marked(disparity, values, removed, Status.MISMATCH)


def steps_of(n_disparities: int) -> int:
    """Return the number of steps into which a pixel of disparity is divided."""
    return max(1, min(_MAX_STEPS, 32767 // n_disparities))
