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

from depthcli.algorithms.dense_crf._mean_field_kernels import join_lattices, start, update
from depthcli.algorithms.dense_crf.permutohedral import BAND, Lattice, blur
from depthcli.core import memory
from depthcli.kernels.lanes import LANES


@dataclass(frozen=True)
class GaussianKernel:
    """One Gaussian kernel: which points influence each other, and how much.

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
    """Compute approximate marginals of every label at every point.

    Parameters
    ----------
    unary : (N, L) float32 energies, finite
    kernels : one or more
    compatibility : mu; an (L, L) array costs O(L^2) a point, :class:`TruncatedLinear` O(L log T)
    iterations : number of steps; 0: the initial marginals are returned
    initial : (N, L) float32 marginals to start from, >= 0; None: softmax(-unary)

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
    start(
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
        update(
            energies, marginals, labels, field.near, field.slots, field.vertex, field.weights, field.corners,
            field.own, truncation, matrix, field.bands, field.width, step + 1 < iterations, field.partial,
        )  # fmt: skip
    return q


@dataclass(frozen=True)
class _Field:
    # The lattices of all kernels side by side: columns of ``slots`` and ``weights`` are the corners of all lattices.
    # Weights include the normalization and the square root of the kernel's weight, so that spreading and reading with
    # the same weights and adding all columns gives the message. ``own`` (N,) is a point's message to itself. ``near``
    # and ``far`` hold the vertices of all lattices, each followed by a row of zeros.

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
            join_lattices(
                lattice.slots, lattice.weights, density, share, np.float32(kernel.weight), np.int32(slot), column,
                slots, weights, own,
            )  # fmt: skip
            column += lattice.slots.shape[1]
            slot += lattice.vertex.size
            vertex += lattice.vertices + 1
        first_vertex = np.cumsum([0] + [lattice.vertices + 1 for lattice in lattices[:-1]])
        vertices = [lattice.vertex + np.int32(start) for lattice, start in zip(lattices, first_vertex, strict=False)]
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
            rows = slice(vertex * self.width, (vertex + lattice.vertices + 1) * self.width)
            partial = self.partial[slot * self.width : (slot + lattice.vertex.size) * self.width]
            blur(lattice, self.width, partial, self.near[rows], self.far[rows])
            slot += lattice.vertex.size
            vertex += lattice.vertices + 1


def _aligned(size: int) -> NDArray[np.float32]:
    # Float32 whose first is the first of a cache line.
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
