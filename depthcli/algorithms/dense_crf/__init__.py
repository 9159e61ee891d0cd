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
from depthcli.kernels.exponential import exp_minus
from depthcli.kernels.jit import empty, helper, jit, run_bands, zeros

_TILE = 16  # points that are processed together: their labels stay in the first-level cache


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
    partial, near, far = (memory.empty((size * labels,), np.float32) for size in (slot, row, row))
    q: Floats = memory.empty((count, labels), np.float32)
    arrays = np.ascontiguousarray(unary), q, near.reshape(-1, labels)
    graph = slots, np.concatenate(rows), weights, own, min(truncation, labels), np.concatenate(bands, axis=1)
    last = iterations if corners else 0
    for step in range(last + 1):
        slot = row = 0
        for lattice in lattices if step else ():
            blur(lattice, labels, partial[slot * labels :], near[row * labels :], far[row * labels :])
            slot, row = slot + lattice.vertex.size, row + lattice.vertices + 1
        run_bands(_update, len(bands[0]), *arrays, *graph, step > 0, step < last, partial.reshape(-1, labels))
    return q


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
def _update(begin, end, unary, q, near, slots, vertex, weights, own, truncation, bands, receive, send, partial):
    # Write the marginals of all points to ``q``, and spread them over the slots in ``partial`` if ``send``. They are
    # computed from the energies and, if ``receive``, the messages in ``near``; otherwise they are softmax(-unary).
    count, labels = unary.shape
    # Messages of a tile follow each other, with zeros between them for windows that reach beyond their ends.
    margin = truncation - 1
    stride = labels + margin
    for b in range(begin, end):
        if send:
            for k in range(0, bands.shape[1], 2):
                partial[bands[b, k] : bands[b, k + 1]] = np.float32(0)
        messages = zeros(_TILE * stride + 2 * margin, np.float32)
        sums, scratch = np.zeros_like(messages), np.zeros_like(messages)
        gains = twice = np.zeros_like(messages)
        spare = np.zeros_like(messages)
        powers = empty(labels, np.float32)
        stop = min(count, (b + 1) * BAND)
        for first in range(b * BAND, stop, _TILE):
            points = range(first, min(first + _TILE, stop))
            if receive:
                for n in points:
                    at = margin + (n - first) * stride
                    message = messages[at : at + labels]
                    # The values of the point's vertices, without its own share.
                    message[:] = np.float32(0)
                    _add_scaled(q[n], -own[n], message)
                    for c in range(slots.shape[1]):
                        _add_scaled(near[vertex[slots[n, c]]], weights[n, c], message)
                # min(|k|, T) is T minus a triangle, and a triangle is two windows of length T in succession. T times
                # the sum of all messages is equal for all labels of a point, so it does not change its marginals.
                once = _window(messages, truncation, sums, scratch)
                gains = _window(once, truncation, twice, spare)
            for n in points:
                at = (n - first) * stride
                total = _softmax(unary[n], gains[at : at + labels], powers, q[n])
                if send:
                    for c in range(slots.shape[1]):
                        _add_scaled(powers, weights[n, c] / total, partial[slots[n, c]])


@helper
def _add_scaled(source, factor, target):
    for k in range(target.size):
        target[k] += factor * source[k]


@helper
def _window(source, length, result, scratch):
    # Return ``result`` or ``scratch``, with source[i] + ... + source[i + length - 1] at every i up to size - length.
    # The window doubles for every further binary digit of its length, and grows by one if the digit is 1: more
    # additions than a running sum, but vectorized. Both arrays take turns, since a loop in place would not be.
    digit, width, size = 0, 1, source.size
    while length >> (digit + 1):
        digit += 1
    for i in range(size):
        result[i] = source[i]
    while digit > 0:
        digit -= 1
        first, second = result[: size - width], result[width:]
        for i in range(first.size):
            scratch[i] = first[i] + second[i]
        width *= 2
        if (length >> digit) & 1:
            further = source[width:]
            for i in range(further.size):
                scratch[i] += further[i]
            width += 1
        result, scratch = scratch, result
    return result


@helper
def _softmax(unary, gain, powers, marginals):
    # powers = exp(smallest energy - energy), with energy = unary - gain; marginals = powers / total. Return the total.
    lowest, total = np.float32(3e38), np.float32(0)
    for k in range(powers.size):
        powers[k] = unary[k] - gain[k]
        lowest = min(lowest, powers[k])
    for k in range(powers.size):
        powers[k] = exp_minus(powers[k] - lowest)
        total += powers[k]
    for k in range(powers.size):
        marginals[k] = powers[k] / total
    return total
