"""Sub-pixel disparities from the parabola through three costs."""

from __future__ import annotations

import numpy as np

from depthcli.core.maps import DisparityMap
from depthcli.kernels.jit import parallel_jit, prange
from depthcli.methods.stereo.refinement import Refinement
from depthcli.methods.stereo.volume import CostMinima, RefinementContext


class Subpixel(Refinement):
    """Move every whole-pixel disparity to the minimum of the parabola through its cost and the two beside it.

    Values that are not whole numbers, whose cost is no local minimum (filled ones, for example), or at an end of the
    range are not changed.
    """

    needs_costs = False

    def halo(self) -> int | None:
        return 0

    def __call__(self, disparity: DisparityMap, context: RefinementContext) -> DisparityMap:
        volume = context.volume
        if isinstance(volume, CostMinima):
            values = np.where(disparity.values == volume.left, volume.minima, disparity.values)
        else:
            values = disparity.values.copy()
            move_to_minimum(volume.costs, values)
        return DisparityMap(values, disparity.status)


@parallel_jit
def move_to_minimum(costs, values):
    """Move (H, W) float32 ``values`` to the minima of parabolas, in place."""
    height, width, n_disparities = costs.shape
    for y in prange(height):
        for x in range(width):
            if np.isnan(values[y, x]):
                continue
            d = int(values[y, x])
            if values[y, x] != d or d < 1 or d + 1 >= min(n_disparities, x + 1):
                continue
            below, lowest, above = float(costs[y, x, d - 1]), float(costs[y, x, d]), float(costs[y, x, d + 1])
            curvature = below + above - 2.0 * lowest
            if below >= lowest and above >= lowest and curvature > 0.0:
                values[y, x] = np.float32(d + 0.5 * (below - above) / curvature)
