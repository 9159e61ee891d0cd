"""Left-right check: matches of the two views must agree."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from depthcli.core.maps import DisparityMap
from depthcli.kernels.jit import helper, jit, run_bands, zeros
from depthcli.methods.stereo.refinement import Refinement
from depthcli.methods.stereo.volume import RefinementContext


class LeftRightCheck(Refinement):
    """Remove pixels whose disparity differs from the right view's disparity at their match.

    The right view's map is read from the same volume, which is much faster than matching again. A removed pixel is
    occluded if no pixel of the right view is matched to it, and otherwise mismatched (Hirschmueller 2008).
    """

    needs_costs = False
    aliases = ("LRC",)

    tolerance: float = Field(
        1.0, ge=0, le=16384, description="largest accepted difference of the views' disparities, pixels"
    )

    def halo(self) -> int | None:
        return 0

    def __call__(self, disparity: DisparityMap, context: RefinementContext) -> DisparityMap:
        values, status = np.empty_like(disparity.values), disparity.status.copy()
        limits = np.float32(self.tolerance), context.volume.n_disparities
        run_bands(_check, len(disparity.values), disparity.values, context.right, *limits, values, status)
        return DisparityMap(values, status)


@helper
def _partner_difference(disparity, x, right):
    # |d - d_R| of a pixel in column ``x``, with ``d_R`` at its match; inf if its match is outside. ``right`` (W,) are
    # the right view's disparities in the pixel's row.
    u = x - int(disparity + np.float32(0.5))
    return abs(np.float32(disparity) - np.float32(right[u])) if u >= 0 else np.float32(np.inf)


@jit
def _check(begin, end, values, right, tolerance, n_disparities, out, status):
    occluded, mismatch = np.uint8(1), np.uint8(2)  # Status.OCCLUDED, Status.MISMATCH
    width = values.shape[1]
    for y in range(begin, end):
        matched = zeros(width, np.bool_)  # by a pixel of the right view
        for u in range(width):
            d = right[y, u]
            if 0 <= d < min(n_disparities, width - u) and d == int(d):
                matched[u + int(d)] = True
        for x in range(width):
            d = values[y, x]
            out[y, x] = d
            if np.isnan(d) or _partner_difference(d, x, right[y]) <= tolerance:
                continue
            out[y, x] = np.nan
            status[y, x] |= mismatch if matched[x] else occluded
