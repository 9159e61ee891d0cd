"""Fill pixels without a value from the background next to them."""

from __future__ import annotations

import numpy as np

from depthcli.core.maps import DisparityMap, Floats
from depthcli.kernels.jit import jit, run_bands
from depthcli.methods.stereo.refinement import Refinement, with_filled
from depthcli.methods.stereo.volume import RefinementContext


class BackgroundFill(Refinement):
    """Give every empty pixel the smaller of the nearest values left and right of it on its row.

    An occluded surface is behind the occluding one, so the smaller disparity is more likely. Rows without any value
    are filled from the rows above and below. A map without any value stays empty.
    """

    needs_costs = False
    fills = True

    def __call__(self, disparity: DisparityMap, context: RefinementContext) -> DisparityMap:
        return fill_background(disparity)


def fill_background(disparity: DisparityMap) -> DisparityMap:
    """Return the map filled as by :class:`BackgroundFill`."""
    return with_filled(disparity, filled_from_background(disparity.values))


def filled_from_background(values: Floats) -> Floats:
    """Return (H, W) values filled as by :class:`BackgroundFill`, without NaN unless all are NaN."""
    values = values.copy()
    run_bands(_fill_rows, len(values), values)
    known = np.flatnonzero(~np.isnan(values[:, 0]))  # a row has all values now or none
    if 0 < known.size < len(values):
        above = np.searchsorted(known, np.arange(len(values)), side="right") - 1
        values = values[known[np.maximum(above, 0)]]
    return values


@jit
def _fill_rows(begin, end, values):
    width = values.shape[1]
    for y in range(begin, end):
        row = values[y]
        x = 0
        while x < width:
            if not np.isnan(row[x]):
                x += 1
                continue
            stop = x
            while stop < width and np.isnan(row[stop]):
                stop += 1
            value = row[x - 1] if x > 0 else np.float32(np.inf)
            if stop < width:
                value = min(value, row[stop])
            for u in range(x, stop):
                row[u] = value if value < np.inf else np.float32(np.nan)
            x = stop
