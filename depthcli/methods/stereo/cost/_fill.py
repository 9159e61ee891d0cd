"""Kernels that fill a cost volume from two images of features.

Along d the right image is read backwards; with a reversed copy of its row both streams are contiguous. Afterwards,
``fill_outside`` fills the cells whose match is outside the right image.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.core.maps import Image8
from depthcli.kernels.jit import empty, intrinsic, jit, run_bands, types, zeros
from depthcli.kernels.lanes import (
    SHORT_LANES,
    absolute_difference,
    load_like,
    maximum,
    minimum,
    shifted_right,
    splat,
    store,
)


@intrinsic
def popcount(typingctx, value):
    """Return the number of set bits of a uint64 (LLVM ``ctpop``; vectorizes)."""

    def codegen(context, builder, signature, args):
        return builder.ctpop(args[0])

    return types.uint64(types.uint64), codegen


def hamming_volume(left: NDArray[np.uint64], right: NDArray[np.uint64], costs: Image8) -> None:
    """Write the Hamming distance of (H, W) uint64 bit strings into (H, W, D) uint8."""
    run_bands(_count_bits, len(costs), left, right, costs)


@jit
def _count_bits(begin, end, left, right, costs):
    width = left.shape[1]
    n_disparities = costs.shape[2]
    for y in range(begin, end):
        mirror = zeros(width + n_disparities, np.uint64)
        for x in range(width):
            mirror[width - 1 - x] = right[y, x]
        for x in range(width):
            bits = left[y, x]
            row = mirror[width - 1 - x : width - 1 - x + n_disparities]
            out = costs[y, x]
            for i in range(out.size):
                out[i] = np.uint8(popcount(bits ^ row[i]))


def difference_volume(
    left: NDArray[Any],
    right: NDArray[Any],
    costs: Image8,
    limit: int,
    sampling: str = "exact",
    shift: int = 0,
) -> None:
    """Write the sums over channels of the differences of (C, H, W) uint8 or int16 images to (H, W, D) ``costs``.

    Each sum is divided by 2^``shift``, rounded half up, and limited to ``limit``; uint8 images need a ``shift`` of 0.
    ``exact``: ``|left - right|``. ``tolerant``: the sampling-insensitive dissimilarity of Birchfield and Tomasi
    (PAMI 1998). This is the difference between a pixel and the nearest value within half a pixel of its match, from
    left to right or from right to left, whichever is smaller.
    """
    ranges = None
    if sampling == "tolerant":
        ranges = *_half_pixel_range(left), *_half_pixel_range(right)
    kind = left.dtype.type
    run_bands(
        _difference_volume, left.shape[1], left, right, ranges, costs, kind((1 << shift) >> 1), kind(shift), kind(limit)
    )


def _half_pixel_range(image: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    # Smallest and largest value within half a pixel along the row, linear between pixels.
    rows = np.ascontiguousarray(image, np.int16).reshape(-1, image.shape[-1])  # one type: compiled once
    ends = np.empty((2, *rows.shape), np.int16)
    run_bands(_extremes, len(rows), rows, *ends)
    low, high = ends.astype(image.dtype).reshape(2, *image.shape)
    return low, high


@jit
def _extremes(begin, end, rows, low, high):
    width = rows.shape[1]
    padded = width + 2
    for y in range(begin, end):
        row = empty(padded, np.int16)
        for x in range(width):
            row[x + 1] = rows[y, x]
        row[0], row[width + 1] = row[1], row[width]
        left, middle, right, below, above = row[:width], row[1 : width + 1], row[2:padded], low[y], high[y]
        for i in range(below.size):
            below[i] = np.int16(middle[i] + min(left[i], middle[i], right[i])) >> np.int16(1)
            above[i] = np.int16(middle[i] + max(left[i], middle[i], right[i])) >> np.int16(1)


@jit
def _difference_volume(begin, end, left, right, ranges, costs, half, shift, limit):
    # Compiled for int16 and uint8. A vector of bytes is half as long. Its sums stop at 255 and its differences at 0, so
    # ``limit`` is right for it as well.
    channels, _, width = left.shape
    n_disparities = costs.shape[2]
    padded = max(n_disparities, SHORT_LANES)
    row_size = width + padded
    views = channels * row_size  # of the right image, and of its smallest and largest values around
    largest = splat(limit)
    zero = largest - largest
    for y in range(begin, end):
        mirror = zeros((3, channels, row_size), left.dtype)
        for c in range(channels):
            for x in range(width):
                mirror[0, c, width - 1 - x] = right[c, y, x]
                if ranges is not None:
                    mirror[1, c, width - 1 - x], mirror[2, c, width - 1 - x] = ranges[2][c, y, x], ranges[3][c, y, x]
        row = empty(padded, np.uint8)
        for x in range(width):
            at = (y * width + x) * n_disparities
            for first in range(0, padded, SHORT_LANES):
                first = min(first, padded - SHORT_LANES)  # the last vector ends at the last disparity
                total = splat(half)
                for c in range(channels):
                    value, place = splat(left[c, y, x]), c * row_size + width - 1 - x + first
                    other = load_like(value, mirror, place)
                    if ranges is None:
                        total = total + absolute_difference(value, other)
                    else:
                        low, high = splat(ranges[0][c, y, x]), splat(ranges[1][c, y, x])
                        other_low = load_like(value, mirror, place + views)
                        other_high = load_like(value, mirror, place + 2 * views)
                        forth, back = maximum(value - other_high, other_low - value), maximum(other - high, low - other)
                        total = total + maximum(minimum(forth, back), zero)
                total = minimum(shifted_right(total, shift), largest)
                if n_disparities < SHORT_LANES:
                    store(row, 0, total)
                    for i in range(n_disparities):
                        costs[y, x, i] = row[i]
                else:
                    store(costs, at + first, total)
