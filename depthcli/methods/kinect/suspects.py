"""Which measured pixels may show the wrong surface: the band beside depth jumps, on the near side.

A structured-light sensor matches windows of its pattern, so that near surfaces grow over their outline by about
half a window. Whatever fits a model to the measured depth has to leave those pixels out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from depthcli.kernels.jit import jit, parallel_jit, prange

NO_JUMP = 255
_COLUMNS = 64  # a task of the vertical pass: whole cache lines, so that no two threads write to one


@dataclass(frozen=True)
class JumpDistance:
    """How far every pixel lies inside the near side of a depth jump.

    Attributes
    ----------
    row, column : (H, W) uint8, pixels along the row (column) from the nearest jump: 1 = first pixel of the near
        side, ``NO_JUMP`` = none in this run, or 255 and more away, or the pixel is unknown
    length : (H, W) uint8, pixels of the run in the row between a rise and a fall, ``NO_JUMP`` where it is open
        on a side, or as long
    """

    row: NDArray[np.uint8]
    column: NDArray[np.uint8]
    length: NDArray[np.uint8]

    def inside(self, row_reach: int, column_reach: int) -> NDArray[np.bool_]:
        """(H, W) bool: at most ``row_reach`` pixels from a jump in the row, or ``column_reach`` in the column."""
        band: NDArray[np.bool_] = (self.row <= row_reach) | (self.column <= column_reach)
        return band

    def trust(self, none: float, full: float) -> NDArray[np.float32]:
        """(H, W) float32 in [0, 1]: rises from 0 at ``none`` pixels from a row's jump to 1 at ``full`` pixels.

        The middle half of a run that is too short to reach 1 anywhere has at least 0.5: thin things are all edge.
        """
        trust = np.clip((self.row.astype(np.float32) - np.float32(none)) / np.float32(full - none), 0, 1)
        thin = (self.length < 2 * full) & (4 * self.row.astype(np.int32) > self.length)
        result: NDArray[np.float32] = np.where(thin, np.maximum(trust, np.float32(0.5)), trust)
        return result


def jump_distance(disparity: NDArray[np.float32], jump: float = 1.5, gap_tolerance: float = 2.5) -> JumpDistance:
    """Distance from the jumps of more than ``jump`` between consecutive known pixels of a row or column.

    The shadow that a near surface throws on a far one is as wide as the jump between them. Where a gap in a row is
    wider, something else lies in it, and either side may have grown over it: both sides count as near.

    Parameters
    ----------
    disparity : (H, W) float32, pixels, NaN = unknown; the near side is the larger
    jump : pixels
    gap_tolerance : a gap is too wide from this many pixels above the jump over it; ``np.inf``: never
    """
    disparity = np.ascontiguousarray(disparity)
    shape = disparity.shape
    row, length, column = (np.full(shape, NO_JUMP, np.uint8) for _ in range(3))
    _rows(disparity, np.float32(jump), np.float32(gap_tolerance), row, length)
    _columns(disparity, np.float32(jump), column)
    return JumpDistance(row, column, length)


@jit
def _run_start(d, x, last, jump, tolerance, start):  # type: ignore[no-untyped-def]
    """Where the near side that ``x`` lies on begins; ``last`` is the known pixel before."""
    if last < 0:
        return start
    apart = abs(d[x] - d[last])
    if abs(x - last) - 1 > apart + tolerance:
        return x
    if apart > jump:
        return x if d[x] > d[last] else -1
    return start


@parallel_jit
def _rows(disparity, jump, tolerance, nearest, length):  # type: ignore[no-untyped-def]
    height, width = disparity.shape
    for y in prange(height):
        d, out, run = disparity[y], nearest[y], length[y]
        start, last = -1, -1
        for x in range(width):
            if not np.isnan(d[x]):
                start = _run_start(d, x, last, jump, tolerance, start)
                last = x
                if start >= 0:
                    out[x] = min(x - start + 1, 255)
        start, last = -1, -1
        for x in range(width - 1, -1, -1):
            if not np.isnan(d[x]):
                start = _run_start(d, x, last, jump, tolerance, start)
                last = x
                if start >= 0:
                    from_left, from_right = np.int64(out[x]), start - x + 1
                    if from_left < 255:
                        run[x] = min(from_left + from_right - 1, 255)
                    out[x] = min(from_left, from_right)


@parallel_jit
def _columns(disparity, jump, nearest):  # type: ignore[no-untyped-def]
    height, width = disparity.shape
    for task in prange((width + _COLUMNS - 1) // _COLUMNS):
        first = task * _COLUMNS
        end = min(first + _COLUMNS, width)
        start = np.empty(end - first, np.int32)
        last = np.empty(end - first, np.int32)
        for step in (1, -1):
            start[:] = -1
            last[:] = -1
            for k in range(height):
                y = k if step == 1 else height - 1 - k
                for x in range(first, end):
                    i = x - first
                    here = disparity[y, x]
                    if not np.isnan(here):
                        if last[i] >= 0:
                            before = disparity[last[i], x]
                            if abs(here - before) > jump:
                                start[i] = y if here > before else -1
                        last[i] = y
                        if start[i] >= 0:
                            nearest[y, x] = min(np.int64(nearest[y, x]), abs(y - start[i]) + 1)
