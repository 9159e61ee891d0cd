"""Means over cross supports whose arms are cut to those of the match in the other view.

The cut makes every arm depend on the disparity. Both passes still read prefix sums, at a place of its own for
every d; sum and number of pixels travel in one word, so that one difference gives both.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from depthcli.core import memory
from depthcli.kernels.jit import parallel_jit, prange

# First pass: the sum of an arm, above 9 bits of its length. An arm has at most 511 pixels of at most 4080.
_LENGTH_BITS = 9


def intersected_means(
    source: NDArray[np.uint16],
    arms: NDArray[np.uint8],
    target: NDArray[np.uint8],
    horizontal_first: bool,
    out: NDArray[np.uint16] | None = None,
) -> NDArray[np.uint16]:
    """Return means over the first arms of all pixels on the second arm of every pixel.

    Parameters
    ----------
    source : (H, W, D) at most 4080
    arms, target : (4, H, W) left, right, up, down arms of the left and of the right view
    out : where to write the means, ``source`` itself allowed; default: a new array
    """
    height, width, n_disparities = source.shape
    # Along d the other view is read backwards; behind its border stands an arm that cuts nothing.
    mirrored = np.full((4, height, width + n_disparities), 255, np.uint8)
    mirrored[:, :, :width] = target[:, :, ::-1]
    spans: NDArray[np.uint32] = memory.empty(source.shape, np.uint32)
    means: NDArray[np.uint16] = memory.empty(source.shape, np.uint16) if out is None else out
    if horizontal_first:
        _row_spans(source, arms, mirrored, spans)
        _column_means(spans, arms, mirrored, means)
    else:
        _column_spans(source, arms, mirrored, spans)
        _row_means(spans, arms, mirrored, means)
    return means


# Index arithmetic is unsigned, which spares the test for negative indices.


@parallel_jit
def _row_spans(source, arms, mirrored, spans):
    height, width, n_disparities = source.shape
    bits = np.uint32(_LENGTH_BITS)
    for y in prange(height):
        prefix = np.zeros((width + 1) * n_disparities, np.uint32)
        costs = source[y].reshape(width * n_disparities)
        later = prefix[n_disparities:]
        for i in range(costs.size):
            later[i] = prefix[i] + np.uint32(costs[i])
        for x in range(width):
            before, after = arms[0, y, x], arms[1, y, x]
            cut_before = mirrored[0, y, width - 1 - x : width - 1 - x + n_disparities]
            cut_after = mirrored[1, y, width - 1 - x : width - 1 - x + n_disparities]
            out = spans[y, x]
            for d in range(out.size):
                b, a = np.uint64(min(before, cut_before[d])), np.uint64(min(after, cut_after[d]))
                low = (np.uint64(x) - b) * np.uint64(n_disparities) + np.uint64(d)
                length = a + b + np.uint64(1)
                total = prefix[low + length * np.uint64(n_disparities)] - prefix[low]
                out[d] = np.uint32((total << bits) | np.uint32(length))


@parallel_jit
def _column_spans(source, arms, mirrored, spans):
    height, width, n_disparities = source.shape
    bits = np.uint32(_LENGTH_BITS)
    block = 4
    for start in prange((width + block - 1) // block):
        x0 = start * block
        x1 = min(width, x0 + block)
        run = (x1 - x0) * n_disparities
        prefix = np.zeros((height + 1) * run, np.uint32)
        for y in range(height):
            costs = source[y, x0:x1].reshape(run)
            here = prefix[y * run : (y + 1) * run]
            there = prefix[(y + 1) * run : (y + 2) * run]
            for i in range(costs.size):
                there[i] = here[i] + np.uint32(costs[i])
        for y in range(height):
            for x in range(x0, x1):
                before, after = arms[2, y, x], arms[3, y, x]
                cut_before = mirrored[2, y, width - 1 - x : width - 1 - x + n_disparities]
                cut_after = mirrored[3, y, width - 1 - x : width - 1 - x + n_disparities]
                out = spans[y, x]
                offset = np.uint64((x - x0) * n_disparities)
                for d in range(out.size):
                    b, a = np.uint64(min(before, cut_before[d])), np.uint64(min(after, cut_after[d]))
                    low = (np.uint64(y) - b) * np.uint64(run) + offset + np.uint64(d)
                    length = a + b + np.uint64(1)
                    total = prefix[low + length * np.uint64(run)] - prefix[low]
                    out[d] = np.uint32((total << bits) | np.uint32(length))


@parallel_jit
def _column_means(spans, arms, mirrored, means):
    height, width, n_disparities = spans.shape
    bits, mask = np.uint64(_LENGTH_BITS), np.uint64((1 << _LENGTH_BITS) - 1)
    block = 4
    for start in prange((width + block - 1) // block):
        x0 = start * block
        x1 = min(width, x0 + block)
        run = (x1 - x0) * n_disparities
        # sum << 32 | number: the number of pixels of a column of arms is far below 2 ** 32
        prefix = np.zeros((height + 1) * run, np.uint64)
        total = np.empty(n_disparities, np.uint64)
        for y in range(height):
            packed = spans[y, x0:x1].reshape(run)
            here = prefix[y * run : (y + 1) * run]
            there = prefix[(y + 1) * run : (y + 2) * run]
            for i in range(packed.size):
                word = np.uint64(packed[i])
                there[i] = here[i] + (((word >> bits) << np.uint64(32)) | (word & mask))
        for y in range(height):
            for x in range(x0, x1):
                before, after = arms[2, y, x], arms[3, y, x]
                cut_before = mirrored[2, y, width - 1 - x : width - 1 - x + n_disparities]
                cut_after = mirrored[3, y, width - 1 - x : width - 1 - x + n_disparities]
                offset = np.uint64((x - x0) * n_disparities)
                for d in range(total.size):
                    b, a = np.uint64(min(before, cut_before[d])), np.uint64(min(after, cut_after[d]))
                    low = (np.uint64(y) - b) * np.uint64(run) + offset + np.uint64(d)
                    total[d] = prefix[low + (a + b + np.uint64(1)) * np.uint64(run)] - prefix[low]
                out = means[y, x]
                for d in range(out.size):
                    number = np.float32(np.int32(np.uint32(total[d])))
                    out[d] = np.uint16(
                        np.int32(np.float32(np.int32(total[d] >> np.uint64(32))) / number + np.float32(0.5))
                    )


@parallel_jit
def _row_means(spans, arms, mirrored, means):
    height, width, n_disparities = spans.shape
    bits, mask = np.uint64(_LENGTH_BITS), np.uint64((1 << _LENGTH_BITS) - 1)
    for y in prange(height):
        prefix = np.zeros((width + 1) * n_disparities, np.uint64)
        total = np.empty(n_disparities, np.uint64)
        packed = spans[y].reshape(width * n_disparities)
        later = prefix[n_disparities:]
        for i in range(packed.size):
            word = np.uint64(packed[i])
            later[i] = prefix[i] + (((word >> bits) << np.uint64(32)) | (word & mask))
        for x in range(width):
            before, after = arms[0, y, x], arms[1, y, x]
            cut_before = mirrored[0, y, width - 1 - x : width - 1 - x + n_disparities]
            cut_after = mirrored[1, y, width - 1 - x : width - 1 - x + n_disparities]
            for d in range(total.size):
                b, a = np.uint64(min(before, cut_before[d])), np.uint64(min(after, cut_after[d]))
                low = (np.uint64(x) - b) * np.uint64(n_disparities) + np.uint64(d)
                total[d] = prefix[low + (a + b + np.uint64(1)) * np.uint64(n_disparities)] - prefix[low]
            out = means[y, x]
            for d in range(out.size):
                number = np.float32(np.int32(np.uint32(total[d])))
                out[d] = np.uint16(np.int32(np.float32(np.int32(total[d] >> np.uint64(32))) / number + np.float32(0.5)))
