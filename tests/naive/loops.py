"""Costs and aggregations of chapter 3 of the thesis as plain loops over its equations, for numba to compile.

Compiled for one thread, or for all by ``parallel=True``, they are the sequential and the naive programs that figure 3.2
compares optimized ones with (``scripts/thesis``). Images are float32, volumes (H, W, D) float32; cells whose match lies
outside the right image are left as they are. Indices of ``prange`` are unsigned in numba, hence ``int64``.
"""

import numpy as np
from numba import prange
from numba.extending import register_jitable

__all__ = ["arms", "box", "derivatives", "difference", "hamming", "ranks", "signatures", "weights"]


@register_jitable
def _prefix_sums(line):
    length, depth = line.shape
    prefix = np.zeros((length + 1, depth), np.float32)
    for x in range(length):
        for d in range(depth):
            prefix[x + 1, d] = prefix[x, d] + line[x, d]
    return prefix


def box(source, out, radius):
    n, length, depth = source.shape
    for i in prange(n):
        prefix = _prefix_sums(source[i])
        for x in range(length):
            low, high = max(0, x - radius), min(length, x + radius + 1)
            for d in range(depth):
                out[i, x, d] = prefix[high, d] - prefix[low, d]


def arms(source, out, own, other, along_rows):
    n, length, depth = source.shape
    for i in prange(n):
        prefix = _prefix_sums(source[i])
        for x in range(length):
            for d in range(depth):
                j, y = (np.int64(i), x - d) if along_rows else (np.int64(i) - d, x)
                before, after = own[0, i, x], own[1, i, x]
                if j >= 0 and y >= 0:
                    before, after = min(before, other[0, j, y]), min(after, other[1, j, y])
                out[i, x, d] = prefix[x + after + 1, d] - prefix[x - before, d]


def weights(source, out, left, right, radius, first):
    n, width, depth = out.shape
    for i in prange(n):
        y = first + np.int64(i)
        for x in range(width):
            for d in range(min(depth, x + 1)):
                total, norm = np.float32(0), np.float32(0)
                for v in range(max(0, y - radius), min(source.shape[0], y + radius + 1)):
                    for u in range(max(d, x - radius), min(width, x + radius + 1)):
                        color = np.float32(0)
                        for c in range(3):
                            color += (left[y, x, c] - left[v, u, c]) ** 2 + (
                                right[y, x - d, c] - right[v, u - d, c]
                            ) ** 2
                        space = np.float32(2 * ((x - u) ** 2 + (y - v) ** 2))
                        weight = np.exp(-(color / np.float32(900) + space / np.float32(300)))
                        total += weight * source[v, u, d]
                        norm += weight
                out[i, x, d] = total / norm


def difference(left, right, out):
    height, width, depth = out.shape
    for y in prange(height):
        for x in range(width):
            for d in range(min(depth, x + 1)):
                total = np.float32(0)
                for c in range(left.shape[2]):
                    total += abs(left[y, x, c] - right[y, x - d, c])
                out[y, x, d] = total


def derivatives(image, out, taps):
    height, width = image.shape
    for i in prange(height - 4):
        y = np.int64(i) + 2
        for x in range(2, width - 2):
            for k in range(2):
                total = np.float32(0)
                for v in range(5):
                    for u in range(5):
                        total += taps[k, v, u] * image[y + v - 2, x + u - 2]
                out[y, x, k] = total


def ranks(image, out):
    height, width = image.shape
    for i in prange(height - 8):
        y = np.int64(i) + 4
        for x in range(4, width - 4):
            for v in range(-4, 5):
                for u in range(-4, 5):
                    out[y, x, 0] += np.float32(image[y + v, x + u] < image[y, x])


def signatures(image, out):
    height, width = image.shape
    for i in prange(height - 6):
        y = np.int64(i) + 3
        for x in range(4, width - 4):
            for v in range(-3, 4):
                for u in range(-4, 5):
                    out[y, x] = (out[y, x] << np.uint64(1)) | np.uint64(image[y + v, x + u] > image[y, x])


def hamming(left, right, out):
    height, width, depth = out.shape
    for y in prange(height):
        for x in range(width):
            for d in range(min(depth, x + 1)):
                bits, count = left[y, x] ^ right[y, x - d], 0
                while bits:
                    bits &= bits - np.uint64(1)
                    count += 1
                out[y, x, d] = count
