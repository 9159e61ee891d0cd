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

from depthcli.core import memory
from depthcli.kernels.exponential import bits_float, exp_minus, float_bits
from depthcli.kernels.jit import jit, parallel_jit, prange
from depthcli.labelling.permutohedral import BAND, Lattice, blur

_TILE = 64  # points whose labels are worked on together, label by label
_LANES = 16  # rows of labels are padded to a multiple


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
    compatibility : mu; an (L, L) array costs O(L^2) a point, :class:`TruncatedLinear` O(L)
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
    q: NDArray[np.float32] = memory.empty((count, labels), np.float32)
    if initial is None:
        _softmax(unary, q)
    else:
        q[:] = initial
    active = [kernel for kernel in kernels if kernel.weight > 0]
    if not active or iterations == 0 or count == 0:
        if iterations and count:
            _softmax(unary, q)
        return q
    field = _Field.of(active, labels)
    if isinstance(compatibility, TruncatedLinear):
        truncation, matrix = min(compatibility.truncation, labels), np.zeros((0, 0), np.float32)
    else:
        truncation, matrix = 0, np.ascontiguousarray(compatibility, np.float32)
    _spread_first(q, field.slots, field.weights, field.bands, field.partial)
    for step in range(iterations):
        field.blur()
        _update(
            unary, q, field.near, field.slots, field.vertex, field.weights, field.own, truncation, matrix,
            field.bands, step + 1 < iterations, field.partial,
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
    slots: NDArray[np.int32]
    vertex: NDArray[np.int32]
    weights: NDArray[np.float32]
    own: NDArray[np.float32]
    bands: NDArray[np.int64]
    partial: NDArray[np.float32]
    near: NDArray[np.float32]
    far: NDArray[np.float32]

    @classmethod
    def of(cls, kernels: Sequence[GaussianKernel], labels: int) -> _Field:
        lattices = tuple(Lattice.of(kernel.features) for kernel in kernels)
        weights, slots, vertex = [], [], []
        own = np.zeros(len(kernels[0].features), np.float32)
        slot_offset = vertex_offset = 0
        for kernel, lattice in zip(kernels, lattices, strict=True):
            density = lattice.filter(np.ones((own.size, 1), np.float32))[:, 0]
            scale = np.sqrt(np.float32(kernel.weight) / density)
            own += lattice.own_share(density) * scale * scale
            weights.append(lattice.weights * scale[:, None])
            slots.append(lattice.slots + np.int32(slot_offset))
            vertex.append(lattice.vertex + np.int32(vertex_offset))
            slot_offset += lattice.vertex.size
            vertex_offset += lattice.vertices + 1
        padded = -(-labels // _LANES) * _LANES
        # Row b of `bands`: the slots of band b in every lattice, as (first, last + 1) pairs.
        starts = np.cumsum([0] + [lattice.vertex.size for lattice in lattices[:-1]])
        bands = np.stack(
            [side + start for lattice, start in zip(lattices, starts, strict=True)
             for side in (lattice.first_slot[:-1], lattice.first_slot[1:])], axis=1,
        )  # fmt: skip
        return cls(
            lattices, np.concatenate(slots, axis=1), np.concatenate(vertex), np.concatenate(weights, axis=1), own,
            np.ascontiguousarray(bands), memory.empty((slot_offset, padded), np.float32),
            memory.empty((vertex_offset, padded), np.float32), memory.empty((vertex_offset, padded), np.float32),
        )  # fmt: skip

    def blur(self) -> None:
        slot = vertex = 0
        for lattice in self.lattices:
            ours = slice(vertex, vertex + lattice.vertices + 1)
            blur(lattice, self.partial[slot : slot + lattice.vertex.size], self.near[ours], self.far[ours])
            slot += lattice.vertex.size
            vertex = ours.stop


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
            raise ValueError(
                f"want features ({count}, d) float32, got {kernel.features.shape} {kernel.features.dtype}"
            )
        if not 0 <= kernel.weight < np.inf:
            raise ValueError(f"want a weight >= 0, got {kernel.weight}")
    if not isinstance(compatibility, TruncatedLinear) and compatibility.shape != (labels, labels):
        raise ValueError(f"want compatibilities ({labels}, {labels}), got {compatibility.shape}")
    if not (_finite(unary) and (initial is None or _finite(initial))):
        raise ValueError("unary energies and initial marginals must be finite")
    return labels, count


def _finite(values: NDArray[np.float32]) -> bool:
    # The sum of many finite values may overflow, their extremes cannot.
    return bool(np.isfinite(values.min(initial=0)) and np.isfinite(values.max(initial=0)))


@jit
def _spread(row: Any, slots: Any, weights: Any, partial: Any) -> None:
    """Add one point's marginals to its slots."""
    corners = slots.size
    for c in range(0, corners - 1, 2):
        w, target = weights[c], partial[slots[c], : row.size]
        v, other = weights[c + 1], partial[slots[c + 1], : row.size]
        for k in range(row.size):
            target[k] += w * row[k]
            other[k] += v * row[k]
    if corners % 2:
        w, target = weights[corners - 1], partial[slots[corners - 1], : row.size]
        for k in range(row.size):
            target[k] += w * row[k]


@jit
def _read(near: Any, slots: Any, vertex: Any, weights: Any, share: Any, old: Any, row: Any) -> None:
    """One point's message: what its vertices hold, less what it sent itself."""
    corners = slots.size
    for k in range(row.size):
        row[k] = -share * old[k]
    for c in range(0, corners - 2, 3):
        u, v, w = weights[c], weights[c + 1], weights[c + 2]
        one = near[vertex[slots[c]], : row.size]
        two = near[vertex[slots[c + 1]], : row.size]
        three = near[vertex[slots[c + 2]], : row.size]
        for k in range(row.size):
            row[k] += u * one[k] + v * two[k] + w * three[k]
    for c in range(corners - corners % 3, corners):
        w, one = weights[c], near[vertex[slots[c]], : row.size]
        for k in range(row.size):
            row[k] += w * one[k]


@parallel_jit
def _spread_first(q: Any, slots: Any, weights: Any, bands: Any, partial: Any) -> None:
    for b in prange(bands.shape[0]):
        for k in range(0, bands.shape[1], 2):
            partial[bands[b, k] : bands[b, k + 1]] = np.float32(0.0)
        for n in range(b * BAND, min(q.shape[0], (b + 1) * BAND)):
            _spread(q[n], slots[n], weights[n], partial)


@parallel_jit
def _update(
    unary: Any, q: Any, near: Any, slots: Any, vertex: Any, weights: Any, own: Any, truncation: int, matrix: Any,
    bands: Any, more: bool, partial: Any,
) -> None:  # fmt: skip
    """One step of mean field for all points: read messages, new marginals into ``q``, spread those (if ``more``)."""
    count, labels = q.shape
    for b in prange(bands.shape[0]):
        if more:
            for k in range(0, bands.shape[1], 2):
                partial[bands[b, k] : bands[b, k + 1]] = np.float32(0.0)
        rows = np.zeros((_TILE, labels), np.float32)
        # Label by label, so that points are worked on side by side; zeros around spare the ends a special case.
        message = np.zeros((2 * truncation + labels, _TILE), np.float32)
        cost = np.zeros((labels, _TILE), np.float32)
        change = np.zeros(_TILE, np.float32)
        stop = min(count, (b + 1) * BAND)
        for first in range(b * BAND, stop, _TILE):
            size = min(_TILE, stop - first)
            for p in range(size):
                n = first + p
                _read(near, slots[n], vertex, weights[n], own[n], q[n], rows[p])
            for k in range(labels):
                line = message[truncation + k]
                for p in range(line.size):
                    line[p] = rows[p, k]
            if truncation:
                _truncated_linear(message, truncation, cost, change)
            else:
                _product(matrix, message, cost)
            for p in range(size):
                n = first + p
                row = rows[p]
                for k in range(row.size):
                    row[k] = cost[k, p]
                _normalize(row, unary[n], q[n])
                if more:
                    _spread(q[n], slots[n], weights[n], partial)


@jit
def _truncated_linear(message: Any, truncation: int, cost: Any, change: Any) -> None:
    """cost[l] = sum over l' of min(|l - l'|, T) message[T + l'], for a tile of points, by its first differences.

    From l to l + 1 the labels l - T + 1 .. l move one step away, l + 1 .. l + T one step nearer.
    """
    total = cost[0]
    total[:] = np.float32(0.0)
    change[:] = np.float32(0.0)
    for k in range(1, cost.shape[0]):
        source = message[truncation + k]
        distance = np.float32(min(k, truncation))
        for p in range(total.size):
            total[p] += distance * source[p]
    for k in range(truncation + 1):
        source = message[truncation + k]
        sign = np.float32(1.0 if k == 0 else -1.0)
        for p in range(change.size):
            change[p] += sign * source[p]
    two = np.float32(2.0)
    for k in range(1, cost.shape[0]):
        before, here = cost[k - 1], cost[k]
        for p in range(here.size):
            here[p] = before[p] + change[p]
        center, leaving, entering = message[truncation + k], message[k], message[2 * truncation + k]
        for p in range(change.size):
            change[p] += two * center[p] - (leaving[p] + entering[p])


@jit
def _product(matrix: Any, message: Any, cost: Any) -> None:
    for k in range(matrix.shape[0]):
        total = cost[k]
        total[:] = np.float32(0.0)
        for j in range(matrix.shape[1]):
            factor, source = matrix[k, j], message[j]
            for p in range(total.size):
                total[p] += factor * source[p]


@jit
def _normalize(energy: Any, unary: Any, q: Any) -> None:
    """q = softmax(-(energy + unary)), each (L,); ``energy`` is overwritten."""
    # The smallest value by integers that sort as the floats do: a minimum of integers vectorizes.
    least = np.int32(0x7FFFFFFF)
    for k in range(energy.size):
        energy[k] += unary[k]
        bits = float_bits(energy[k])
        least = min(least, np.int32(bits ^ np.int32((bits >> np.int32(31)) & np.int32(0x7FFFFFFF))))
    low = bits_float(np.int32(least ^ np.int32((least >> np.int32(31)) & np.int32(0x7FFFFFFF))))
    total = np.float32(0.0)
    for k in range(energy.size):
        q[k] = exp_minus(energy[k] - low)
        total += q[k]
    factor = np.float32(1.0) / total
    for k in range(q.size):
        q[k] *= factor


@parallel_jit
def _softmax(unary: Any, q: Any) -> None:
    for b in prange((q.shape[0] + BAND - 1) // BAND):
        energy = np.empty(q.shape[1], np.float32)
        for n in range(b * BAND, min(q.shape[0], (b + 1) * BAND)):
            energy[:] = np.float32(0.0)
            _normalize(energy, unary[n], q[n])
