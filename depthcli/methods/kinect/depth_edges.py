"""Distance of every pixel from the depth edges whose near side it lies on: where measurements are unreliable.

A structured-light sensor matches windows of its pattern, so that near surfaces grow over their outline by about
half a window. A fit to the measured depth has to leave those pixels out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from depthcli.kernels.jit import parallel_jit, prange

NO_EDGE = 255
"""Distance of pixels without a depth edge within 254 pixels: the largest uint8."""


@dataclass(frozen=True)
class EdgeDistance:
    """How far every pixel lies inside the near side of a depth edge.

    Attributes
    ----------
    row, column : (H, W) uint8, pixels along the row (column) from the nearest edge: 1 = first pixel of the near
        side, ``NO_EDGE`` = none in this run, or 255 and more away, or the pixel is unknown
    """

    row: NDArray[np.uint8]
    column: NDArray[np.uint8]

    def inside(self, row_band: int, column_band: int) -> NDArray[np.bool_]:
        """Select the pixels at most ``row_band`` from an edge in the row, or ``column_band`` in the column, (H, W)."""
        band: NDArray[np.bool_] = (self.row <= row_band) | (self.column <= column_band)
        return band


def edge_distance(disparity: NDArray[np.float32], jump: float = 1.5, gap_tolerance: float = 2.5) -> EdgeDistance:
    """Compute the distance from steps of more than ``jump`` between consecutive known pixels of a row or column.

    The shadow that a near surface throws on a far one is as wide as the step between them. Where a gap in a row is
    wider, something else lies in it, and either side may have grown over it: both sides count as near.

    Parameters
    ----------
    disparity : (H, W) float32, pixels, NaN = unknown; the near side is the larger
    jump : pixels
    gap_tolerance : a gap is too wide from this many pixels above the step over it; ``np.inf``: never
    """
    distances = []
    for values, tolerance in ((disparity, gap_tolerance), (disparity.T, np.inf)):  # no shadows fall along columns
        distances.append(np.full(values.shape, NO_EDGE, np.uint8))
        _distance_along_rows(np.ascontiguousarray(values), np.float32(jump), np.float32(tolerance), distances[-1])
    return EdgeDistance(distances[0], np.ascontiguousarray(distances[1].T))


@parallel_jit
def _distance_along_rows(disparity, jump, tolerance, nearest):
    height, width = disparity.shape
    for y in prange(height):
        d, out = disparity[y], nearest[y]
        for step in (1, -1):
            start, last = -1, -1  # first pixel of the near side that x lies on, previous known pixel; -1: none
            for k in range(width):
                x = k if step == 1 else width - 1 - k
                if np.isnan(d[x]):
                    continue
                if last >= 0:
                    height_of_step = abs(d[x] - d[last])
                    if abs(x - last) - 1 > height_of_step + tolerance:
                        start = x
                    elif height_of_step > jump:
                        start = x if d[x] > d[last] else -1
                last = x
                if start >= 0:
                    out[x] = min(np.int64(out[x]), abs(x - start) + 1)
