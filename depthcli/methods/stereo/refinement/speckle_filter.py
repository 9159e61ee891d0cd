"""Removal of small regions of disparity."""

from __future__ import annotations

import cv2
import numpy as np
from pydantic import Field

from depthcli.core.maps import DisparityMap, Status
from depthcli.kernels.jit import parallel_jit, prange
from depthcli.methods.stereo.refinement import Refinement
from depthcli.methods.stereo.volume import RefinementContext

_NONE = -32768  # of a pixel without a value
_MAX_STEPS = 16  # of a pixel, as in OpenCV's 16-bit disparities; fewer above 2000 disparities


class SpeckleFilter(Refinement):
    """Remove connected regions of similar disparity that are too small to be trusted (``cv2.filterSpeckles``)."""

    needs_costs = False

    size: int = Field(50, ge=1, le=10**8, description="connected regions of at most this many pixels are removed")
    step: float = Field(1.0, ge=0, le=64, description="largest disparity step within a connected region, pixels")

    def __call__(self, disparity: DisparityMap, context: RefinementContext) -> DisparityMap:
        steps = steps_of(context.volume.n_disparities)
        fixed = np.empty(disparity.values.shape, np.int16)
        _to_steps(disparity.values, np.float32(steps), fixed)
        cv2.filterSpeckles(fixed, _NONE, self.size, self.step * steps)
        values, status = disparity.values.copy(), disparity.status.copy()
        _remove(fixed, np.uint8(Status.MISMATCH), values, status)
        return DisparityMap(values, status)


def steps_of(n_disparities: int) -> int:
    """Return the number of steps into which a pixel of disparity is divided."""
    return max(1, min(_MAX_STEPS, 32767 // n_disparities))


@parallel_jit
def _to_steps(values, steps, fixed):
    for y in prange(values.shape[0]):
        for x in range(values.shape[1]):
            value = values[y, x]
            fixed[y, x] = np.int16(_NONE) if np.isnan(value) else np.int16(np.rint(value * steps))


@parallel_jit
def _remove(fixed, mark, values, status):
    for y in prange(fixed.shape[0]):
        for x in range(fixed.shape[1]):
            if fixed[y, x] == _NONE and not np.isnan(values[y, x]):
                values[y, x] = np.nan
                status[y, x] |= mark
