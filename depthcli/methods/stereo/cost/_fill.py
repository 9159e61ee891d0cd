"""Kernels that fill a cost volume from two images of features.

Along d the right image is read backwards; with a reversed copy of its row both streams are contiguous. Cells whose
match lies outside the right image are filled by ``fill_outside`` afterwards.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.kernels.jit import intrinsic, parallel_jit, prange, types
from depthcli.kernels.lanes import (
    SHORT_LANES,
    absolute_difference,
    load_shorts,
    maximum,
    minimum,
    shifted_right,
    splat_shorts,
    store,
)


@intrinsic
def popcount(typingctx, value):
    """Return the number of set bits of a uint64 (LLVM ``ctpop``; vectorizes)."""

    def codegen(context, builder, signature, args):
        return builder.ctpop(args[0])

    return types.uint64(types.uint64), codegen


@parallel_jit
def hamming_volume(left, right, costs):
    """Write the Hamming distance of (H, W) uint64 bit strings into (H, W, D) uint8."""
    height, width = left.shape
    n_disparities = costs.shape[2]
    for y in prange(height):
        mirror = np.zeros(width + n_disparities, np.uint64)
        mirror[:width] = right[y, ::-1]
        for x in range(width):
            bits = left[y, x]
            row = mirror[width - 1 - x : width - 1 - x + n_disparities]
            out = costs[y, x]
            for i in range(out.size):
                out[i] = np.uint8(popcount(bits ^ row[i]))


def difference_volume(
    left: NDArray[Any],
    right: NDArray[Any],
    costs: NDArray[np.uint8],
    limit: int,
    sampling: str = "exact",
    shift: int = 0,
) -> None:
    """Write the sums over channels of the differences of (C, H, W) images into (H, W, D) ``costs``.

    The sum is divided by 2^``shift`` (rounded half up), at most ``limit``. ``exact``: ``|left - right|``. ``tolerant``:
    the sampling-insensitive dissimilarity of Birchfield and Tomasi (PAMI 1998), the difference of a pixel from the
    nearest value that the other image has within half a pixel of its match; the smaller one of left to right and right
    to left.
    """
    left, right = left.astype(np.int16, copy=False), right.astype(np.int16, copy=False)  # one type to compile for
    tolerant = sampling == "tolerant"
    low, high = _half_pixel_range(left) if tolerant else (left, left)
    right_low, right_high = _half_pixel_range(right) if tolerant else (right, right)
    _difference_volume(left, low, high, right, right_low, right_high, costs, tolerant, np.int16(shift), np.int16(limit))


def _half_pixel_range(image: NDArray[np.int16]) -> tuple[NDArray[np.int16], NDArray[np.int16]]:
    # Smallest and largest value within half a pixel along the row, linear between pixels.
    padded = np.pad(image, ((0, 0), (0, 0), (1, 1)), mode="edge")
    between = (padded[..., 1:] + padded[..., :-1]) >> 1
    before, after = between[..., :-1], between[..., 1:]
    return np.minimum(image, np.minimum(before, after)), np.maximum(image, np.maximum(before, after))


@parallel_jit
def _difference_volume(left, left_low, left_high, right, right_low, right_high, costs, tolerant, shift, limit):
    channels, height, width = left.shape
    n_disparities = costs.shape[2]
    padded = max(n_disparities, SHORT_LANES)
    row_size = width + padded
    half, zero, largest = splat_shorts(np.int16((1 << shift) >> 1)), splat_shorts(np.int16(0)), splat_shorts(limit)
    for y in prange(height):
        mirror = np.zeros((3 * channels, row_size), np.int16)
        for c in range(channels):
            mirror[3 * c, :width] = right[c, y, ::-1]
            if tolerant:
                mirror[3 * c + 1, :width] = right_low[c, y, ::-1]
                mirror[3 * c + 2, :width] = right_high[c, y, ::-1]
        flat = mirror.reshape(3 * channels * row_size)
        row = np.empty(padded, np.uint8)
        out = costs[y].reshape(width * n_disparities)
        for x in range(width):
            at = x * n_disparities
            for first in range(0, padded, SHORT_LANES):
                first = min(first, padded - SHORT_LANES)  # the last vector ends at the last disparity
                total = half
                for c in range(channels):
                    value, place = splat_shorts(left[c, y, x]), 3 * c * row_size + width - 1 - x + first
                    other = load_shorts(flat, place)
                    if tolerant:
                        low, high = splat_shorts(left_low[c, y, x]), splat_shorts(left_high[c, y, x])
                        other_low = load_shorts(flat, place + row_size)
                        other_high = load_shorts(flat, place + 2 * row_size)
                        forth, back = maximum(value - other_high, other_low - value), maximum(other - high, low - other)
                        total = total + maximum(minimum(forth, back), zero)
                    else:
                        total = total + absolute_difference(value, other)
                total = minimum(shifted_right(total, shift), largest)
                if n_disparities < SHORT_LANES:
                    store(row, 0, total)
                    for i in range(n_disparities):
                        out[at + i] = row[i]
                else:
                    store(out, at + first, total)
