"""Sub-pixel disparities from the parabola through three costs."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from depthcli.core.maps import DisparityMap
from depthcli.kernels.jit import parallel_jit, prange
from depthcli.methods.stereo.refinement import Refinement
from depthcli.methods.stereo.volume import CostMinima, RefinementContext


class Subpixel(Refinement):
    """Move every whole-pixel disparity to the minimum of the parabola through its cost and its neighbors'.

    Pixels whose value is not a whole number, or whose cost is no local minimum of the curve (a filled value,
    say), or lies at the end of the range, stay as they are.
    """

    needs_costs: ClassVar[bool] = False

    def halo(self) -> int | None:
        return 0

    def __call__(self, disparity: DisparityMap, context: RefinementContext) -> DisparityMap:
        known = context.volume
        if isinstance(known, CostMinima):
            values = np.where(disparity.values == known.left, known.minima, disparity.values)
        else:
            values = disparity.values.copy()
            move_to_minimum(known.costs, values)
        return DisparityMap(values, disparity.status)


@parallel_jit
def move_to_minimum(costs: Any, values: Any) -> None:
    """Do so for (H, W) float32 ``values``, in place."""
    height, width, depth = costs.shape
    for y in prange(height):
        for x in range(width):
            if np.isnan(values[y, x]):
                continue
            d = int(values[y, x])
            if values[y, x] != d or d < 1 or d + 1 >= min(depth, x + 1):
                continue
            below = float(costs[y, x, d - 1])
            here = float(costs[y, x, d])
            above = float(costs[y, x, d + 1])
            curvature = below + above - 2.0 * here
            if below >= here and above >= here and curvature > 0.0:
                values[y, x] = np.float32(d + 0.5 * (below - above) / curvature)
