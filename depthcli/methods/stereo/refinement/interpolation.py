"""Interpolation of empty pixels from values around them (Mei et al. 2011)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from depthcli.core.maps import DisparityMap, Status
from depthcli.kernels.jit import jit, run_bands
from depthcli.methods.stereo.refinement import Refinement, with_filled
from depthcli.methods.stereo.volume import RefinementContext

# The 16 directions in which the nearest value is searched: (dy, dx) of a step.
_DIRECTIONS: NDArray[np.int64] = np.array(
    [(0, 1), (1, 2), (1, 1), (2, 1), (1, 0), (2, -1), (1, -1), (1, -2),
     (0, -1), (-1, -2), (-1, -1), (-2, -1), (-1, 0), (-2, 1), (-1, 1), (-1, 2)]
)  # fmt: skip


class Interpolation(Refinement):
    """Fill occluded pixels with the lowest value around, mismatched pixels with the value of the most similar color.

    The candidates are the nearest values in 16 directions. A pixel without any candidate stays empty.
    """

    needs_costs = False
    fills = True

    def __call__(self, disparity: DisparityMap, context: RefinementContext) -> DisparityMap:
        values = disparity.values.copy()
        occluded = (disparity.status & np.uint8(Status.OCCLUDED)) != 0
        run_bands(
            _interpolate, len(disparity.values), disparity.values, occluded, context.pair.color8[0], _DIRECTIONS,
            values,
        )  # fmt: skip
        return with_filled(disparity, values)


@jit
def _interpolate(begin, end, values, occluded, image, directions, filled):
    height, width = values.shape
    for y in range(begin, end):
        for x in range(width):
            if not np.isnan(values[y, x]):
                continue
            lowest = np.float32(np.inf)
            closest = 1 << 30
            similar = np.float32(np.nan)
            for k in range(directions.shape[0]):
                v, u = y + directions[k, 0], x + directions[k, 1]
                while 0 <= v < height and 0 <= u < width and np.isnan(values[v, u]):
                    v += directions[k, 0]
                    u += directions[k, 1]
                if not (0 <= v < height and 0 <= u < width):
                    continue
                lowest = min(lowest, values[v, u])
                difference = 0
                for c in range(3):
                    difference += int(abs(np.int32(image[y, x, c]) - np.int32(image[v, u, c])))
                if difference < closest:
                    closest = difference
                    similar = values[v, u]
            if lowest < np.inf:
                filled[y, x] = lowest if occluded[y, x] else similar
