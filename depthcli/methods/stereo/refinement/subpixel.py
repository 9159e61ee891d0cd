"""Sub-pixel disparities from the parabola through three costs."""

from __future__ import annotations

import numpy as np

from depthcli.core.maps import DisparityMap
from depthcli.kernels.jit import jit, run_bands
from depthcli.kernels.winners import parabola_minimum
from depthcli.methods.stereo.refinement import Refinement
from depthcli.methods.stereo.volume import CostMinima, RefinementContext


class Subpixel(Refinement):
    """Move every whole-pixel disparity to the minimum of the parabola through its cost and the two next to it.

    A value is not changed if it is no whole number, if it is at an end of the range, or if its cost is no local minimum
    (as of many filled values).
    """

    needs_costs = False

    def halo(self) -> int | None:
        return 0

    def __call__(self, disparity: DisparityMap, context: RefinementContext) -> DisparityMap:
        values, best, volume = np.empty_like(disparity.values), context.minima, context.volume
        costs = None if isinstance(volume, CostMinima) else volume.costs
        run_bands(_move_to_minima, len(disparity.values), disparity.values, best.left, best.minima, costs, values)
        return DisparityMap(values, disparity.status)


@jit
def _move_to_minima(begin, end, values, left, minima, costs, out):
    for y in range(begin, end):
        for x in range(values.shape[1]):
            value = values[y, x]
            if value == left[y, x]:
                out[y, x] = minima[y, x]
            elif costs is not None and value == np.floor(value):
                out[y, x] = parabola_minimum(costs[y, x, : x + 1], int(value))
            else:
                out[y, x] = value
