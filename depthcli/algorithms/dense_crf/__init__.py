"""Mean field inference in a fully connected CRF (Kraehenbuhl and Koltun, NIPS 2011).

The energy of labels x is ``sum_i U_i(x_i) + sum_{i<j} mu(x_i, x_j) sum_m w_m n_i n_j k_m(f_i, f_j)`` with Gaussian
kernels k_m of features f and the truncated linear ``mu(l, l') = min(|l - l'|, T)``. Kernels are normalized
symmetrically, ``n_i = (sum_j k_m(f_i, f_j))^-1/2``, so that a weight has the same effect at points with many and with
few close points. One step of mean field is

    Q_i(l) ~ exp(-U_i(l) - sum_l' mu(l, l') sum_m w_m sum_{j != i} n_i n_j k_m(f_i, f_j) Q_j(l'))

The inner sums over all j are Gaussian filters on a permutohedral lattice. The cost is linear in the number of points
and O(L log T) in labels.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from depthcli.algorithms.dense_crf.permutohedral import BAND, Lattice, blur
from depthcli.core import memory
from depthcli.core.maps import Floats, Ints
from depthcli.kernels.jit import helper, jit, run_bands, zeros
from depthcli.kernels.lanes import LANES, exp_minus, lane_min, lane_sum, load, minimum, splat, store

_TILE = 16  # points that are processed together: their labels stay in the first-level cache
_BLOCK = 4 * LANES  # labels that are in registers together
_NEVER = np.float32(1e30)  # energy of the labels that pad the last vector


class GaussianKernel(NamedTuple):
    """A Gaussian kernel, through which close points influence each other."""

    features: Floats  # (N, d) float32, 1 <= d <= 8, each divided by its standard deviation
    weight: float  # factor w_m of the kernel in the energy, >= 0


def mean_field(unary: Floats, kernels: Sequence[GaussianKernel], truncation: int, iterations: int = 5) -> Floats:
    """Return approximate marginals (N, L) of every label at every point, the same bytes for any number of threads.

    Energies ``unary`` (N, L) are finite. ``truncation`` is T; T = 1 is the Potts model. The first step starts from
    softmax(-unary), the result of 0 iterations. ValueError: features are not finite, or too many or too far apart for
    the lattice.
    """
    count, labels = unary.shape
    width = -(-labels // LANES) * LANES
    if width > labels:
        unary = np.pad(unary, ((0, 0), (0, width - labels)), constant_values=_NEVER)
    kernels = [kernel for kernel in kernels if kernel.weight > 0 and iterations]
    lattices = [Lattice.of(kernel.features) for kernel in kernels]
    # The lattices are concatenated for one pass over the points. ``slots`` are the C corners of all simplices of a
    # point. ``weights`` include the normalization and the square root of the kernel's weight, so that spreading,
    # reading and adding all columns gives the message. ``own`` is a point's message to itself, to be subtracted.
    corners = sum(lattice.slots.shape[1] for lattice in lattices)
    slots: Ints = memory.empty((count, corners), np.int32)
    weights: Floats = memory.empty((count, corners), np.float32)
    own = np.zeros(count, np.float32)
    # ``rows``: the row of every slot in arrays of all vertices, in which a row of zeros follows each lattice. ``bands``
    # (B, 2 K): the slots of a band in each of the K lattices, as first and last + 1.
    rows, bands = [np.zeros(0, np.int32)], [np.zeros((-(-count // BAND), 0), np.int64)]
    slot = row = column = 0
    for kernel, lattice in zip(kernels, lattices, strict=True):
        density = lattice.filter(np.ones((count, 1), np.float32))[:, 0]
        share, scale = lattice.own_share(density), np.float32(kernel.weight)
        source = (lattice.slots, lattice.weights, density, share, scale, np.int32(slot), column)
        run_bands(_join, own.size, *source, slots, weights, own)
        rows.append(lattice.vertex + np.int32(row))
        bands.append(np.stack([lattice.first_slot[:-1], lattice.first_slot[1:]], axis=1) + slot)
        slot, row = slot + lattice.vertex.size, row + lattice.vertices + 1
        column += lattice.slots.shape[1]
    partial, near, far = (_aligned(size * width) for size in (slot, row, row))
    q: Floats = memory.empty((count, width), np.float32)
    arrays = np.ascontiguousarray(unary).reshape(-1), q.reshape(-1), near
    graph = slots.reshape(-1), np.concatenate(rows), weights.reshape(-1), corners, own
    limits = min(truncation, labels), np.concatenate(bands, axis=1), width
    last = iterations if corners else 0
    for step in range(last + 1):
        slot = row = 0
        for lattice in lattices if step else ():
            blur(lattice, width, partial[slot * width :], near[row * width :], far[row * width :])
            slot, row = slot + lattice.vertex.size, row + lattice.vertices + 1
        run_bands(_update, len(bands[0]), *arrays, *graph, *limits, step > 0, step < last, partial)
    return q if width == labels else np.ascontiguousarray(q[:, :labels])


def _aligned(size: int) -> Floats:
    # Return an uninitialized float32 array that starts at a cache line.
    block: Floats = memory.empty((size + 16,), np.float32)
    skip = -(block.ctypes.data // 4) % 16
    return block[skip : skip + size]


@jit
def _join(begin, end, slots, weights, density, share, weight, offset, column, all_slots, all_weights, own):
    # Write slots and normalized weights of one lattice to the columns of all lattices, from ``column`` on.
    for n in range(begin, end):
        scale = np.sqrt(weight / density[n])
        own[n] += share[n] * scale * scale
        for c in range(slots.shape[1]):
            all_slots[n, column + c] = slots[n, c] + offset
            all_weights[n, column + c] = weights[n, c] * scale


@jit
def _update(
    begin, end, unary, q, near, slots, vertex, weights, corners, own, truncation, bands, width, receive, send, partial
):
    # Write the marginals of all points to ``q``, and spread them over the slots in ``partial`` if ``send``. They are
    # computed from the energies and, if ``receive``, the messages in ``near``; otherwise they are softmax(-unary).
    count = own.size
    # Rows of a tile follow each other, with zeros between them for windows that reach beyond the ends of rows.
    margin = truncation - 1
    lead = -(-margin // LANES) * LANES
    stride = -(-(width + margin) // LANES) * LANES
    for b in range(begin, end):
        if send:
            _clear(partial, bands, b, width)
        # Windows read beyond the last row by their length.
        message = zeros(_TILE * stride + 4 * lead + LANES, np.float32)
        once, twice = np.zeros_like(message), np.zeros_like(message)
        total = np.ones(_TILE, np.float32)
        stop = min(count, (b + 1) * BAND)
        for first in range(b * BAND, stop, _TILE):
            size = min(_TILE, stop - first)
            if receive:
                _read(near, width, slots, vertex, weights, corners, own, q, first, size, message, lead, stride)
                # min(|k|, T) is T minus a triangle, and a triangle is two windows of length T in succession. T times
                # the sum of all messages is equal for all labels of a point, so it does not change its marginals.
                _window(message, truncation, once)
                _window(once, truncation, twice)
            _softmax(unary, twice, lead - margin, stride, width, first, size, once, total, q)
            if send:
                _spread(once, stride, total, slots, weights, corners, first, size, width, partial)


@helper
def _clear(partial, bands, b, width):
    zero = splat(np.float32(0.0))
    for k in range(0, bands.shape[1], 2):
        for i in range(bands[b, k] * width, bands[b, k + 1] * width, LANES):
            store(partial, i, zero)


@helper
def _spread(tile, stride, total, slots, weights, corners, first, size, width, partial):
    # Add the marginals of points, the rows of a tile divided by their ``total``, to their slots.
    for p in range(size):
        factor = np.float32(1.0) / total[p]
        begin, at = (first + p) * corners, p * stride
        for k in range(0, width - _BLOCK + 1, _BLOCK):
            v0, v1 = load(tile, at + k), load(tile, at + k + LANES)
            v2, v3 = load(tile, at + k + 2 * LANES), load(tile, at + k + 3 * LANES)
            for c in range(begin, begin + corners):
                w, to = splat(factor * weights[c]), slots[c] * width + k
                store(partial, to, load(partial, to) + w * v0)
                store(partial, to + LANES, load(partial, to + LANES) + w * v1)
                store(partial, to + 2 * LANES, load(partial, to + 2 * LANES) + w * v2)
                store(partial, to + 3 * LANES, load(partial, to + 3 * LANES) + w * v3)
        for k in range(width - width % _BLOCK, width, LANES):
            value = load(tile, at + k)
            for c in range(begin, begin + corners):
                to = slots[c] * width + k
                store(partial, to, load(partial, to) + splat(factor * weights[c]) * value)


@helper
def _read(near, width, slots, vertex, weights, corners, own, q, first, size, message, lead, stride):
    # Write the messages of points to the rows of a tile: values of their vertices without the points' own share.
    for p in range(size):
        begin, at, to = (first + p) * corners, (first + p) * width, lead + p * stride
        share = splat(-own[first + p])
        for k in range(0, width - _BLOCK + 1, _BLOCK):
            v0, v1 = share * load(q, at + k), share * load(q, at + k + LANES)
            v2, v3 = share * load(q, at + k + 2 * LANES), share * load(q, at + k + 3 * LANES)
            for c in range(begin, begin + corners):
                w, source = splat(weights[c]), vertex[slots[c]] * width + k
                v0 += w * load(near, source)
                v1 += w * load(near, source + LANES)
                v2 += w * load(near, source + 2 * LANES)
                v3 += w * load(near, source + 3 * LANES)
            store(message, to + k, v0)
            store(message, to + k + LANES, v1)
            store(message, to + k + 2 * LANES, v2)
            store(message, to + k + 3 * LANES, v3)
        for k in range(width - width % _BLOCK, width, LANES):
            value = share * load(q, at + k)
            for c in range(begin, begin + corners):
                value += splat(weights[c]) * load(near, vertex[slots[c]] * width + k)
            store(message, to + k, value)


@helper
def _window(source, length, target):
    # target[i] = source[i] + ... + source[i + length - 1]. The window doubles for every further binary digit of its
    # length, and grows by one if the digit is 1: more additions than a running sum, but on 16 labels at a time.
    digit = 0
    while length >> (digit + 1):
        digit += 1
    for i in range(0, source.size - LANES + 1, LANES):
        store(target, i, load(source, i))
    width = 1
    while digit > 0:
        digit -= 1
        if (length >> digit) & 1:
            for i in range(0, source.size - 2 * width - LANES + 1, LANES):
                store(target, i, load(target, i) + load(target, i + width) + load(source, i + 2 * width))
            width = 2 * width + 1
        else:
            for i in range(0, source.size - width - LANES + 1, LANES):
                store(target, i, load(target, i) + load(target, i + width))
            width = 2 * width


@helper
def _softmax(unary, gain, begin, stride, width, first, size, tile, total, q):
    # tile = exp(smallest energy - energy), with energy = unary - gain, row by row; total = sums of the rows;
    # q = tile / total.
    for p in range(size):
        source, at = (first + p) * width, p * stride
        low = splat(np.float32(3e38))
        for k in range(0, width, LANES):
            energy = load(unary, source + k) - load(gain, begin + at + k)
            store(tile, at + k, energy)
            low = minimum(low, energy)
        total[p] = lane_min(low)
    # A separate loop, so that the exponentials of a point do not wait for its smallest energy.
    for p in range(size):
        at, to = p * stride, (first + p) * width
        low, sums = splat(total[p]), splat(np.float32(0.0))
        for k in range(0, width, LANES):
            power = exp_minus(load(tile, at + k) - low)
            store(tile, at + k, power)
            sums += power
        total[p] = lane_sum(sums)
        factors = splat(np.float32(1.0) / total[p])
        for k in range(0, width, LANES):
            store(q, to + k, factors * load(tile, at + k))
