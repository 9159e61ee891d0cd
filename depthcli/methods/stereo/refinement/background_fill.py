"""Fill pixels without a value from the background beside them."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from depthcli.core.maps import DisparityMap, Status
from depthcli.kernels.jit import parallel_jit, prange
from depthcli.methods.stereo.refinement import Refinement
from depthcli.methods.stereo.volume import RefinementContext


class BackgroundFill(Refinement):
    """Give every empty pixel the smaller of the nearest values left and right of it on its row.

    What is occluded lies behind what occludes it, so the smaller disparity is the likely one. Rows without any
    value are filled from the rows above and below. A map without any value stays empty.
    """

    needs_costs: ClassVar[bool] = False
    fills: ClassVar[bool] = True

    def __call__(self, disparity: DisparityMap, context: RefinementContext) -> DisparityMap:
        return fill_background(disparity)


def fill_background(disparity: DisparityMap) -> DisparityMap:
    """What :class:`BackgroundFill` does: it needs no context."""
    values = disparity.values.copy()
    _fill_rows(values)
    _fill_columns(values)
    filled = np.where(~disparity.valid & ~np.isnan(values), np.uint8(Status.FILLED), np.uint8(0))
    return DisparityMap(values, disparity.status | filled)


@parallel_jit
def _fill_rows(values: Any) -> None:
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
            if x > 0 and end < width:
                value = min(row[x - 1], row[end])
            elif x > 0:
                value = row[x - 1]
            elif end < width:
                value = row[end]
            else:
                value = np.float32(np.nan)
            row[x:end] = value
            x = end


@parallel_jit
def _fill_columns(values: Any) -> None:
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
