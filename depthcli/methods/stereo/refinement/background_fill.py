"""Fill pixels without a value from the background beside them."""

from __future__ import annotations

import numpy as np

from depthcli.core.maps import DisparityMap
from depthcli.kernels.jit import parallel_jit, prange
from depthcli.methods.stereo.refinement import Refinement, with_filled
from depthcli.methods.stereo.volume import RefinementContext


class BackgroundFill(Refinement):
    """Give every empty pixel the smaller of the nearest values left and right of it on its row.

    An occluded surface lies behind the occluding one, so the smaller disparity is more likely. Rows without any value
    are filled from the rows above and below. A map without any value stays empty.
    """

    needs_costs = False
    fills = True

    def __call__(self, disparity: DisparityMap, context: RefinementContext) -> DisparityMap:
        return fill_background(disparity)


def fill_background(disparity: DisparityMap) -> DisparityMap:
    """Return the map filled as by :class:`BackgroundFill`."""
    values = disparity.values.copy()
    _fill_rows(values)
    _fill_columns(values)
    return with_filled(disparity, values)


@parallel_jit
def _fill_rows(values):
    height, width = values.shape
    for y in prange(height):
        row = values[y]
        x = 0
        while x < width:
            if not np.isnan(row[x]):
                x += 1
                continue
            end = x
            while end < width and np.isnan(row[end]):
                end += 1
            value = row[x - 1] if x > 0 else np.float32(np.inf)
            if end < width:
                value = min(value, row[end])
            row[x:end] = value if value < np.inf else np.float32(np.nan)
            x = end


@parallel_jit
def _fill_columns(values):
    # Only rows that had no value at all are left.
    height, width = values.shape
    for x in prange(width):
        last = np.float32(np.nan)
        for y in range(height):
            if np.isnan(values[y, x]):
                values[y, x] = last
            else:
                last = values[y, x]
        for y in range(height - 2, -1, -1):
            if np.isnan(values[y, x]):
                values[y, x] = values[y + 1, x]
