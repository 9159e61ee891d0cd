"""Kernels that fill a cost volume from two images of features.

Along d the right image is read backwards; with a reversed copy of its row both streams are contiguous and the compiler
uses SIMD. Cells whose match lies outside the right image are filled by ``fill_outside`` afterwards.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numpy.typing import NDArray

from depthcli.kernels.jit import intrinsic, parallel_jit, prange, types
from depthcli.kernels.lanes import SHORT_LANES, load_shorts, maximum, minimum, shifted_right, splat_shorts, store


@intrinsic
def popcount(typingctx: Any, value: Any) -> Any:
    """Return the number of set bits of an unsigned integer (LLVM ``ctpop``; vectorizes)."""
    if not isinstance(value, types.Integer):
        return None

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kind = ir.IntType(signature.args[0].bitwidth)
        function = builder.module.declare_intrinsic("llvm.ctpop", [kind])
        return builder.call(function, args)

    return value(value), codegen


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


@parallel_jit
def difference_volume(left, right, costs, limit):
    """Write the sum over channels of |left - right|, at most ``limit``, of (C, H, W) uint8 into (H, W, D) uint8."""
    channels, height, width = left.shape
    n_disparities = costs.shape[2]
    for y in prange(height):
        mirror = np.zeros((channels, width + n_disparities), np.uint8)
        mirror[:, :width] = right[:, y, ::-1]
        for x in range(width):
            start = width - 1 - x
            out = costs[y, x]
            if channels == 3:
                a, b, c = np.int16(left[0, y, x]), np.int16(left[1, y, x]), np.int16(left[2, y, x])
                row_a = mirror[0, start : start + n_disparities]
                row_b = mirror[1, start : start + n_disparities]
                row_c = mirror[2, start : start + n_disparities]
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
                    row_a = mirror[k, start : start + n_disparities]
                    for i in range(out.size):
                        total = np.int16(np.int16(out[i]) + np.int16(abs(np.int16(a - np.int16(row_a[i])))))
                        out[i] = np.uint8(min(total, limit))


@parallel_jit
def _half_pixel_ranges(features, low, high):
    # Smallest and largest value of (C, H, W) ``features`` within half a pixel along the row, linear between pixels.
    channels, height, width = features.shape
    kind = features.dtype.type
    for y in prange(height):
        for c in range(channels):
            for x in range(width):
                center = np.int32(features[c, y, x])
                left = (center + np.int32(features[c, y, max(x - 1, 0)])) >> 1
                right = (center + np.int32(features[c, y, min(x + 1, width - 1)])) >> 1
                low[c, y, x] = kind(min(center, left, right))
                high[c, y, x] = kind(max(center, left, right))


def tolerant_volume(
    left: NDArray[Any], right: NDArray[Any], costs: NDArray[np.uint8], shift: int, limit: np.int16
) -> None:
    """Write the sum over channels of the sampling-insensitive dissimilarity of Birchfield and Tomasi (PAMI 1998).

    It is the difference of a pixel from the nearest value that the other image has within half a pixel of its match;
    the smaller one of left to right and right to left. Of (C, H, W) images, the (H, W, D) ``costs`` become the sum
    divided by 2^``shift`` (rounded half up), at most ``limit``.
    """
    left, right = left.astype(np.int16, copy=False), right.astype(np.int16, copy=False)  # one type to compile for
    left_low, left_high = np.empty_like(left), np.empty_like(left)
    _half_pixel_ranges(left, left_low, left_high)
    right_low, right_high = np.empty_like(right), np.empty_like(right)
    _half_pixel_ranges(right, right_low, right_high)
    _tolerant_volume(left, left_low, left_high, right, right_low, right_high, costs, np.int16(shift), np.int16(limit))


@parallel_jit
def _tolerant_volume(left, left_low, left_high, right, right_low, right_high, costs, shift, limit):
    channels, height, width = left.shape
    n_disparities = costs.shape[2]
    padded = max(n_disparities, SHORT_LANES)
    half, zero, largest = splat_shorts(np.int16((1 << shift) >> 1)), splat_shorts(np.int16(0)), splat_shorts(limit)
    for y in prange(height):
        row_size = width + padded
        mirror = np.zeros((3 * channels, row_size), np.int16)
        for c in range(channels):
            mirror[3 * c, :width] = right[c, y, ::-1]
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
                    value = splat_shorts(np.int16(left[c, y, x]))
                    low, high = splat_shorts(np.int16(left_low[c, y, x])), splat_shorts(np.int16(left_high[c, y, x]))
                    place = 3 * c * row_size + width - 1 - x + first
                    other = load_shorts(flat, place)
                    other_low, other_high = load_shorts(flat, place + row_size), load_shorts(flat, place + 2 * row_size)
                    forth = maximum(value - other_high, other_low - value)
                    back = maximum(other - high, low - other)
                    total = total + maximum(minimum(forth, back), zero)
                total = minimum(shifted_right(total, shift), largest)
                if n_disparities < SHORT_LANES:
                    store(row, 0, total)
                    out[at : at + n_disparities] = row[:n_disparities]
                else:
                    store(out, at + first, total)
