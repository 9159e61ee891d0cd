"""Depth discontinuity adjustment (Mei et al. 2011)."""

from __future__ import annotations

import numpy as np

from depthcli.core.maps import DisparityMap
from depthcli.kernels.jit import jit, run_bands
from depthcli.methods.stereo.refinement import Refinement, with_smoothed
from depthcli.methods.stereo.volume import CostVolume, RefinementContext


class DiscontinuityAdjustment(Refinement):
    """Replace a disparity at a jump by a neighbor's disparity if this has a lower cost at the pixel."""

    def __call__(self, disparity: DisparityMap, context: RefinementContext) -> DisparityMap:
        values = disparity.values
        assert isinstance(context.volume, CostVolume)
        for axis in (1, 0):
            adjusted = values.copy()
            dy, dx = 1 - axis, axis
            run_bands(_adjust, values.shape[0] - 2 * dy, values, context.volume.costs, dy, dx, adjusted)
            values = adjusted
        return with_smoothed(disparity, values)


@jit
def _adjust(begin, end, values, costs, dy, dx, adjusted):
    # Neighbors are ``dy`` rows and ``dx`` columns away on both sides. ``begin`` and ``end`` count from row ``dy``.
    _, width, n_disparities = costs.shape
    for y in range(dy + begin, dy + end):
        for x in range(dx, width - dx):
            current = values[y, x]
            one, two = values[y - dy, x - dx], values[y + dy, x + dx]
            if np.isnan(current) or np.isnan(one) or np.isnan(two):
                continue
            if abs(current - one) <= 1.0 and abs(current - two) <= 1.0:
                continue
            best = current
            k = int(current + np.float32(0.5))
            lowest = np.float32(np.inf)
            if k <= x and k < n_disparities:
                lowest = np.float32(costs[y, x, k])
            for other in (one, two):
                k = int(other + np.float32(0.5))
                if k <= x and k < n_disparities and np.float32(costs[y, x, k]) < lowest:
                    lowest = np.float32(costs[y, x, k])
                    best = other
            adjusted[y, x] = best
