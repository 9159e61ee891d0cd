"""Fill a cost volume from two per-pixel feature images.

All volumes are (H, W, D) with D innermost. Along d the right image is read backwards; a reversed copy of
its row makes both streams contiguous, so that the compiler can use SIMD. What is written where the match
lies outside the right image means nothing: ``fill_outside`` comes after.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.core import memory
from depthcli.kernels.bits import popcount
from depthcli.kernels.jit import parallel_jit, prange


@parallel_jit
def hamming_volume(left: Any, right: Any, costs: Any) -> None:
    """Hamming distance of (H, W) uint64 bit strings into (H, W, D) uint8."""
    height, width = left.shape
    depth = costs.shape[2]
    for y in prange(height):
        mirror = np.zeros(width + depth, np.uint64)
        mirror[:width] = right[y, ::-1]
        for x in range(width):
            bits = left[y, x]
            row = mirror[width - 1 - x : width - 1 - x + depth]
            out = costs[y, x]
            for i in range(out.size):
                out[i] = np.uint8(popcount(bits ^ row[i]))


@parallel_jit
def difference_volume(left: Any, right: Any, costs: Any, limit: Any) -> None:
    """Sum over channels of |left - right|, at most ``limit``, of (C, H, W) uint8 into (H, W, D) uint8."""
    channels, height, width = left.shape
    depth = costs.shape[2]
    for y in prange(height):
        mirror = np.zeros((channels, width + depth), np.uint8)
        mirror[:, :width] = right[:, y, ::-1]
        for x in range(width):
            start = width - 1 - x
            out = costs[y, x]
            if channels == 3:
                a = np.int16(left[0, y, x])
                b = np.int16(left[1, y, x])
                c = np.int16(left[2, y, x])
                row_a = mirror[0, start : start + depth]
                row_b = mirror[1, start : start + depth]
                row_c = mirror[2, start : start + depth]
                for i in range(out.size):
                    total = np.int16(
                        np.int16(abs(np.int16(a - np.int16(row_a[i]))))
                        + np.int16(abs(np.int16(b - np.int16(row_b[i]))))
                        + np.int16(abs(np.int16(c - np.int16(row_c[i]))))
                    )
                    out[i] = np.uint8(min(total, limit))
            else:
                out[:] = 0
                for k in range(channels):
                    a = np.int16(left[k, y, x])
                    row_a = mirror[k, start : start + depth]
                    for i in range(out.size):
                        total = np.int16(np.int16(out[i]) + np.int16(abs(np.int16(a - np.int16(row_a[i])))))
                        out[i] = np.uint8(min(total, limit))


def empty_volume(shape: tuple[int, int], disparities: int) -> NDArray[np.uint8]:
    """An uninitialised (H, W, D) uint8 volume; every kernel here writes every cell."""
    return memory.empty((*shape, disparities), np.uint8)
