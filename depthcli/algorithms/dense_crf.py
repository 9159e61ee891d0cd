"""Mean field inference in a fully connected CRF (Kraehenbuhl and Koltun, NIPS 2011).

The energy of labels x is ``sum_i U_i(x_i) + sum_{i<j} mu(x_i, x_j) sum_m w_m n_i n_j k_m(f_i, f_j)`` with Gaussian
kernels k_m of features f. Kernels are normalized symmetrically, ``n_i = (sum_j k_m(f_i, f_j))^-1/2``, so that a
weight means the same at crowded and at lonely points. One step of mean field is

    Q_i(l) ~ exp(-U_i(l) - sum_l' mu(l, l') sum_m w_m sum_{j != i} n_i n_j k_m(f_i, f_j) Q_j(l'))

whose inner sums over all j are Gaussian filters on a permutohedral lattice: linear in points and labels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.permutohedral import BAND, Lattice, blur
from depthcli.core import memory
from depthcli.kernels.exponential import float_bits
from depthcli.kernels.jit import jit, parallel_jit, prange
from depthcli.kernels.lanes import LANES, exp_minus, least, load, smaller, splat, store, total_of

_TILE = 16  # points whose labels are worked on together: they stay in the first cache
_BLOCK = 4 * LANES  # labels that are held in registers together


@dataclass(frozen=True)
class GaussianKernel:
    """Which points pull on each other, and how much.

    Attributes
    ----------
    features : (N, d) float32, 1 <= d <= 8, each divided by its standard deviation
    weight : >= 0
    """

    features: NDArray[np.float32]
    weight: float


@dataclass(frozen=True)
class TruncatedLinear:
    """mu(l, l') = min(|l - l'|, truncation): piecewise smooth. A truncation of 1 is Potts's model."""

    truncation: int

    def __post_init__(self) -> None:
        if self.truncation < 1:
            raise ValueError(f"want a truncation of at least 1 label, got {self.truncation}")


def mean_field(
    unary: NDArray[np.float32],
    kernels: Sequence[GaussianKernel],
    compatibility: TruncatedLinear | NDArray[np.floating[Any]],
    iterations: int = 5,
    initial: NDArray[np.float32] | None = None,
) -> NDArray[np.float32]:
    """Approximate marginals of every label at every point.

    Parameters
    ----------
    unary : (N, L) float32 energies, finite
    kernels : one or more
    compatibility : mu; an (L, L) array costs O(L^2) a point, :class:`TruncatedLinear` O(L log T)
    iterations : steps; 0 gives the start
    initial : (N, L) float32 marginals to start from, >= 0; softmax(-unary) where not given

    Returns
    -------
    (N, L) float32, each row sums to 1; the same bytes at any number of threads

    Raises
    ------
    ValueError
        For shapes that do not fit, values that are not finite, negative weights, or features too many or too far
        apart for the lattice.
    """
    labels, count = _check(unary, kernels, compatibility, iterations, initial)
    active = [kernel for kernel in kernels if kernel.weight > 0]
    given = initial is not None and (iterations == 0 or bool(active))
    q: NDArray[np.float32] = memory.empty((count, labels), np.float32)
    if initial is not None and given:
        q[:] = initial
    field = _Field.of(active if iterations else [], count, labels)
    energies, marginals = np.ascontiguousarray(unary).reshape(-1), q.reshape(-1)
    finite = np.ones(len(field.bands), np.bool_)
    _first(
        energies, marginals, given, labels, field.slots, field.weights, field.corners, field.bands, field.width,
        field.partial, finite,
    )  # fmt: skip
    if not finite.all():
        raise ValueError("unary energies must be finite")
    if field.corners == 0:
        return q
    if isinstance(compatibility, TruncatedLinear):
        truncation, matrix = min(compatibility.truncation, labels), np.zeros((0, 0), np.float32)
    else:
        truncation, matrix = 0, np.ascontiguousarray(compatibility.T, np.float32)
    for step in range(iterations):
        field.blur()
        _update(
            energies, marginals, labels, field.near, field.slots, field.vertex, field.weights, field.corners,
            field.own, truncation, matrix, field.bands, field.width, step + 1 < iterations, field.partial,
        )  # fmt: skip
    return q


@dataclass(frozen=True)
class _Field:
    """All kernels side by side: the columns of ``slots`` and ``weights`` run over the corners of all lattices.

    Weights hold the normalization and the square root of the kernel's weight, so that spreading and reading with
    the same weights and adding up all columns gives the message. ``own`` (N,) is what a point sends to itself.
    ``near`` and ``far`` hold the vertices of all lattices, each followed by a row of zeros.
    """

    lattices: tuple[Lattice, ...]
    corners: int
    width: int
    slots: NDArray[np.int32]
    vertex: NDArray[np.int32]
    weights: NDArray[np.float32]
    own: NDArray[np.float32]
    bands: NDArray[np.int64]
    partial: NDArray[np.float32]
    near: NDArray[np.float32]
    far: NDArray[np.float32]

    @classmethod
    def of(cls, kernels: Sequence[GaussianKernel], count: int, labels: int) -> _Field:
        lattices = tuple(Lattice.of(kernel.features) for kernel in kernels)
        corners = sum(lattice.slots.shape[1] for lattice in lattices)
        slots: NDArray[np.int32] = memory.empty((count, corners), np.int32)
        weights: NDArray[np.float32] = memory.empty((count, corners), np.float32)
        own = np.zeros(count, np.float32)
        column = slot = vertex = 0
        for kernel, lattice in zip(kernels, lattices, strict=True):
            density = lattice.filter(np.ones((count, 1), np.float32))[:, 0]
            share = lattice.own_share(density)
            _join(
                lattice.slots, lattice.weights, density, share, np.float32(kernel.weight), np.int32(slot), column,
                slots, weights, own,
            )  # fmt: skip
            column += lattice.slots.shape[1]
            slot += lattice.vertex.size
            vertex += lattice.vertices + 1
        before = np.cumsum([0] + [lattice.vertices + 1 for lattice in lattices[:-1]])
        vertices = [lattice.vertex + np.int32(start) for lattice, start in zip(lattices, before, strict=False)]
        # Row b of `bands`: the slots of band b in every lattice, as (first, last + 1) pairs.
        starts = np.cumsum([0] + [lattice.vertex.size for lattice in lattices[:-1]])
        bands = [side + start for lattice, start in zip(lattices, starts, strict=False)
                 for side in (lattice.first_slot[:-1], lattice.first_slot[1:])]  # fmt: skip
        width = -(-labels // LANES) * LANES
        return cls(
            lattices, corners, width, slots.reshape(-1), np.concatenate([*vertices, np.zeros(0, np.int32)]),
            weights.reshape(-1), own, np.stack(bands, axis=1) if bands else np.zeros((-(-count // BAND), 0), np.int64),
            _aligned(slot * width), _aligned(vertex * width), _aligned(vertex * width),
        )  # fmt: skip

    def blur(self) -> None:
        slot = vertex = 0
        for lattice in self.lattices:
            ours = slice(vertex * self.width, (vertex + lattice.vertices + 1) * self.width)
            partial = self.partial[slot * self.width : (slot + lattice.vertex.size) * self.width]
            blur(lattice, self.width, partial, self.near[ours], self.far[ours])
            slot += lattice.vertex.size
            vertex += lattice.vertices + 1


def _aligned(size: int) -> NDArray[np.float32]:
    """Floats that begin at the beginning of a line of the cache."""
    block: NDArray[np.float32] = memory.empty((size + 16,), np.float32)
    skip = -(block.ctypes.data // 4) % 16
    return block[skip : skip + size]


def _check(
    unary: NDArray[np.float32],
    kernels: Sequence[GaussianKernel],
    compatibility: TruncatedLinear | NDArray[np.floating[Any]],
    iterations: int,
    initial: NDArray[np.float32] | None,
) -> tuple[int, int]:
    if unary.ndim != 2 or unary.shape[1] == 0 or unary.dtype != np.float32:
        raise ValueError(f"want unary energies (N, L) float32 with L > 0, got {unary.shape} {unary.dtype}")
    count, labels = unary.shape
    if initial is not None and (initial.shape != unary.shape or initial.dtype != np.float32):
        raise ValueError(f"want initial marginals {unary.shape} float32, got {initial.shape} {initial.dtype}")
    if iterations < 0:
        raise ValueError(f"want 0 iterations or more, got {iterations}")
    for kernel in kernels:
        if kernel.features.ndim != 2 or len(kernel.features) != count or kernel.features.dtype != np.float32:
            raise ValueError(f"want features ({count}, d) float32, got {kernel.features.shape} {kernel.features.dtype}")
        if not 0 <= kernel.weight < np.inf:
            raise ValueError(f"want a weight >= 0, got {kernel.weight}")
    if not isinstance(compatibility, TruncatedLinear) and compatibility.shape != (labels, labels):
        raise ValueError(f"want compatibilities ({labels}, {labels}), got {compatibility.shape}")
    if initial is not None and not np.isfinite(initial).all():
        raise ValueError("initial marginals must be finite")
    return labels, count


@parallel_jit
def _join(
    slots: Any, weights: Any, density: Any, share: Any, weight: Any, offset: Any, column: int, all_slots: Any,
    all_weights: Any, own: Any,
) -> None:  # fmt: skip
    """Put the corners of one lattice beside those of others, from ``column`` on, and normalize them."""
    for n in prange(own.size):
        scale = np.sqrt(weight / density[n])
        own[n] += share[n] * scale * scale
        for c in range(slots.shape[1]):
            all_slots[n, column + c] = slots[n, c] + offset
            all_weights[n, column + c] = weights[n, c] * scale


@parallel_jit
def _first(
    unary: Any, q: Any, given: bool, labels: int, slots: Any, weights: Any, corners: int, bands: Any, width: int,
    partial: Any, finite: Any,
) -> None:  # fmt: skip
    """Marginals to start from, into ``q`` unless they are ``given``; spread them, where there are ``corners``.

    ``finite`` says of every band whether all its energies are.
    """
    count = q.size // labels
    for b in prange(finite.size):
        _clear(partial, bands, b, width)
        tile, total = np.zeros(_TILE * width, np.float32), np.ones(_TILE, np.float32)
        largest = np.int32(0)
        stop = min(count, (b + 1) * BAND)
        for first in range(b * BAND, stop, _TILE):
            size = min(_TILE, stop - first)
            for k in range(first * labels, (first + size) * labels):
                largest = max(largest, np.int32(float_bits(unary[np.uint64(k)]) & np.int32(0x7FFFFFFF)))
            source = q if given else unary
            for p in range(size):
                for k in range(labels):
                    tile[np.uint64(p * width + k)] = source[np.uint64((first + p) * labels + k)]
            if not given:
                _softmax(tile, width, labels, width, size, total)
                _write(tile, width, total, q, first, labels, size)
            _spread(tile, width, total, slots, weights, corners, first, size, width, partial)
        # A number that is not finite has larger bits than all others.
        finite[b] = largest < np.int32(0x7F800000)


@parallel_jit
def _update(
    unary: Any, q: Any, labels: int, near: Any, slots: Any, vertex: Any, weights: Any, corners: int, own: Any,
    truncation: int, matrix: Any, bands: Any, width: int, more: bool, partial: Any,
) -> None:  # fmt: skip
    """One step of mean field for all points: read messages, new marginals into ``q``, spread those (if ``more``)."""
    count = own.size
    # Rows of a tile lie one behind the other, with zeros between them for the windows that reach beyond their ends.
    margin = max(truncation - 1, 0)
    lead = -(-margin // LANES) * LANES
    stride = -(-(labels + margin) // LANES) * LANES
    for b in prange(bands.shape[0]):
        if more:
            _clear(partial, bands, b, width)
        # Windows read as far behind the last row as they are long.
        message = np.zeros(_TILE * stride + 4 * lead + LANES, np.float32)
        once, twice = np.zeros_like(message), np.zeros_like(message)
        total, spare = np.ones(_TILE, np.float32), np.zeros(LANES, np.float32)
        stop = min(count, (b + 1) * BAND)
        for first in range(b * BAND, stop, _TILE):
            size = min(_TILE, stop - first)
            _read(
                near, width, slots, vertex, weights, corners, own, q, labels, first, size, message, lead, stride, spare
            )  # fmt: skip
            if truncation:
                # min(|k|, T) is T less a triangle, which is a window of length T over another one. T times the sum
                # of all messages is the same for every label of a point, and makes no difference to its marginals.
                _window(message, truncation, once)
                _window(once, truncation, twice)
                _energies(unary, labels, first, size, np.float32(-1.0), twice, lead - margin, stride, once)
            else:
                _product(matrix, message, stride, size, twice)
                _energies(unary, labels, first, size, np.float32(1.0), twice, 0, stride, once)
            _softmax(once, stride, labels, width, size, total)
            _write(once, stride, total, q, first, labels, size)
            if more:
                _spread(once, stride, total, slots, weights, corners, first, size, width, partial)


@jit
def _clear(partial: Any, bands: Any, b: int, width: int) -> None:
    zero = splat(np.float32(0.0))
    for k in range(0, bands.shape[1], 2):
        for i in range(bands[b, k] * width, bands[b, k + 1] * width, LANES):
            store(partial, i, zero)


@jit
def _spread(
    tile: Any, stride: int, total: Any, slots: Any, weights: Any, corners: int, first: int, size: int, width: int,
    partial: Any,
) -> None:  # fmt: skip
    """Add the points' marginals, the rows of a tile over their ``total``, to their slots."""
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


@jit
def _read(
    near: Any, width: int, slots: Any, vertex: Any, weights: Any, corners: int, own: Any, q: Any, labels: int,
    first: int, size: int, message: Any, lead: int, stride: int, spare: Any,
) -> None:  # fmt: skip
    """The points' messages, into the rows of a tile: what their vertices hold, less what they sent themselves."""
    for p in range(size):
        begin, at, to = (first + p) * corners, (first + p) * labels, lead + p * stride
        share = splat(-own[first + p])
        for k in range(0, labels - _BLOCK + 1, _BLOCK):
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
        for k in range(labels - labels % _BLOCK, labels, LANES):
            if k + LANES <= labels:
                value = share * load(q, at + k)
            else:  # the next point's marginals lie behind
                for rest in range(k, labels):
                    spare[rest - k] = q[at + rest]
                value = share * load(spare, 0)
            for c in range(begin, begin + corners):
                value += splat(weights[c]) * load(near, vertex[slots[c]] * width + k)
            store(message, to + k, value)


@jit
def _window(source: Any, length: int, target: Any) -> None:
    """target[i] = source[i] + ... + source[i + length - 1], where there are as many.

    The window doubles once for every further binary digit of its length, and grows by one where that is 1: more
    additions than a running sum takes, but on sixteen labels at a time.
    """
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


@jit
def _product(matrix: Any, message: Any, stride: int, size: int, cost: Any) -> None:
    """cost = matrix times message, row by row; ``matrix`` is transposed."""
    labels = matrix.shape[0]
    for p in range(size):
        for k in range(labels):
            cost[np.uint64(p * stride + k)] = np.float32(0.0)
        for j in range(labels):
            factor = message[p * stride + j]
            for k in range(labels):
                cost[np.uint64(p * stride + k)] += factor * matrix[j, k]


@jit
def _energies(
    unary: Any, labels: int, first: int, size: int, sign: Any, cost: Any, begin: int, stride: int, tile: Any
) -> None:  # fmt: skip
    """Rows of the tile = unary + sign cost."""
    signs = splat(sign)
    for p in range(size):
        at, source, to = (first + p) * labels, begin + p * stride, p * stride
        for k in range(0, labels - LANES + 1, LANES):
            store(tile, to + k, load(unary, at + k) + signs * load(cost, source + k))
        for k in range(labels - labels % LANES, labels):
            tile[to + k] = unary[at + k] + sign * cost[source + k]


@jit
def _softmax(tile: Any, stride: int, labels: int, width: int, size: int, total: Any) -> None:
    """exp(-energy) of the rows of a tile, less their smallest energies, and their sums; zeros behind the labels."""
    for p in range(size):
        at = p * stride
        for k in range(labels, width):
            tile[at + k] = np.float32(3e38)
        low = load(tile, at)
        for k in range(LANES, width, LANES):
            low = smaller(low, load(tile, at + k))
        total[p] = least(low)
    # One step for all points before the next: the exponentials of one need not wait for its smallest energy.
    for p in range(size):
        at = p * stride
        low, sums = splat(total[p]), splat(np.float32(0.0))
        for k in range(0, width, LANES):
            power = exp_minus(load(tile, at + k) - low)
            store(tile, at + k, power)
            sums += power
        total[p] = total_of(sums)
        for k in range(labels, width):
            tile[at + k] = np.float32(0.0)


@jit
def _write(tile: Any, stride: int, total: Any, q: Any, first: int, labels: int, size: int) -> None:
    """Marginals: the rows of a tile over their ``total``."""
    for p in range(size):
        factor = np.float32(1.0) / total[p]
        factors = splat(factor)
        at, to = p * stride, (first + p) * labels
        for k in range(0, labels - LANES + 1, LANES):
            store(q, to + k, factors * load(tile, at + k))
        for k in range(labels - labels % LANES, labels):
            q[to + k] = factor * tile[at + k]
