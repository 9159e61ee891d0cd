"""Left-right check: matches of the two views must agree."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from depthcli.core.maps import DisparityMap
from depthcli.kernels.jit import parallel_jit, prange
from depthcli.kernels.winners import partner_difference
from depthcli.methods.stereo.refinement import Refinement
from depthcli.methods.stereo.volume import RefinementContext


class LeftRightCheck(Refinement):
    """Remove pixels whose disparity differs from that of the right view at their match.

    The right view's map is read from the same volume, which is many times faster than matching again. A removed pixel
    is occluded if no pixel of the right view at all is matched to it, else mismatched (Hirschmueller 2008).
    """

    needs_costs = False
    aliases = ("LRC",)

    tolerance: float = Field(
        1.0, ge=0, le=16384, description="largest accepted difference of the views' disparities, pixels"
    )

    def halo(self) -> int | None:
        return 0

    def __call__(self, disparity: DisparityMap, context: RefinementContext) -> DisparityMap:
        values, status = disparity.values.copy(), disparity.status.copy()
        _check(values, status, context.right, np.float32(self.tolerance), context.volume.n_disparities)
        return DisparityMap(values, status)


@parallel_jit
def _check(values, status, right, tolerance, n_disparities):
    occluded, mismatch = np.uint8(1), np.uint8(2)
    height, width = values.shape
    for y in prange(height):
        for x in range(width):
            d = values[y, x]
            if np.isnan(d):
                continue
            if partner_difference(d, x, right[y]) <= tolerance:
                continue
            mutual = False
            for other in range(min(n_disparities, x + 1)):
                if right[y, x - other] == other:
                    mutual = True
                    break
            values[y, x] = np.nan
            status[y, x] |= mismatch if mutual else occluded
