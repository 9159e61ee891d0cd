"""Mean field inference in a fully connected CRF (Kraehenbuhl and Koltun, NIPS 2011).

The energy of labels x is ``sum_i U_i(x_i) + sum_{i<j} mu(x_i, x_j) sum_m w_m n_i n_j k_m(f_i, f_j)`` with Gaussian
kernels k_m of features f and the truncated linear ``mu(l, l') = min(|l - l'|, T)``. Kernels are normalized
symmetrically, ``n_i = (sum_j k_m(f_i, f_j))^-1/2``, so that a weight means the same at crowded and at lonely points.
One step of mean field is

    Q_i(l) ~ exp(-U_i(l) - sum_l' mu(l, l') sum_m w_m sum_{j != i} n_i n_j k_m(f_i, f_j) Q_j(l'))

whose inner sums over all j are Gaussian filters on a permutohedral lattice: linear in points; O(L log T) in labels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate

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


def mean_field(
    unary: NDArray[np.float32],
    kernels: Sequence[GaussianKernel],
    truncation: int,
    iterations: int = 5,
) -> NDArray[np.float32]:
    """Compute approximate marginals of every label at every point.

    Parameters
    ----------
    unary : (N, L) float32 energies, finite
    kernels : one or more
    truncation : T >= 1, labels; 1 is Potts's model
    iterations : number of steps from softmax(-unary), which 0 steps return

    Returns
    -------
    (N, L) float32, each row sums to 1; the same bytes at any number of threads

    Raises
    ------
    ValueError
        For shapes that do not fit, values that are not finite, or features too many or too far apart for the lattice.
    """
    if unary.ndim != 2 or unary.shape[1] == 0 or unary.dtype != np.float32:
        raise ValueError(f"want unary energies (N, L) float32 with L > 0, got {unary.shape} {unary.dtype}")
    count, labels = unary.shape
    for kernel in kernels:
        if kernel.features.ndim != 2 or len(kernel.features) != count or kernel.features.dtype != np.float32:
            raise ValueError(f"want features ({count}, d) float32, got {kernel.features.shape} {kernel.features.dtype}")
    q: NDArray[np.float32] = memory.empty((count, labels), np.float32)
    field = _Field.of([kernel for kernel in kernels if kernel.weight > 0 and iterations], count, labels)
    energies, marginals = np.ascontiguousarray(unary).reshape(-1), q.reshape(-1)
    finite = np.ones(len(field.bands), np.bool_)
    start(
        energies, marginals, labels, field.slots, field.weights, field.corners, field.bands, field.width,
        field.partial, finite,
    )  # fmt: skip
    if not finite.all():
        raise ValueError("unary energies must be finite")
    if field.corners == 0:
        return q
    for step in range(iterations):
        field.blur()
        update(
            energies, marginals, labels, field.near, field.slots, field.vertex, field.weights, field.corners,
            field.own, min(truncation, labels), field.bands, field.width, step + 1 < iterations, field.partial,
        )  # fmt: skip
    return q


@dataclass(frozen=True)
class _Field:
    # The lattices of all kernels side by side: columns of ``slots`` and ``weights`` are the corners of all lattices.
    # Weights include the normalization and the square root of the kernel's weight, so that spreading and reading with
    # the same weights and adding all columns gives the message. ``own`` (N,) is a point's message to itself. ``near``
    # and ``far`` hold the vertices of all lattices, each followed by a row of zeros. Lattice k has the slots
    # ``first_slot[k] .. first_slot[k + 1] - 1`` of all, and the rows of ``near`` and ``far`` by ``first_vertex``.

    lattices: tuple[Lattice, ...]
    first_slot: list[int]
    first_vertex: list[int]
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
        first_slot = list(accumulate((lattice.vertex.size for lattice in lattices), initial=0))
        first_vertex = list(accumulate((lattice.vertices + 1 for lattice in lattices), initial=0))
        column = 0
        vertices, bands = [np.zeros(0, np.int32)], []
        for k, (kernel, lattice) in enumerate(zip(kernels, lattices, strict=True)):
            density = lattice.filter(np.ones((count, 1), np.float32))[:, 0]
            share = lattice.own_share(density)
            join_lattices(
                lattice.slots, lattice.weights, density, share, np.float32(kernel.weight), np.int32(first_slot[k]),
                column, slots, weights, own,
            )  # fmt: skip
            column += lattice.slots.shape[1]
            vertices.append(lattice.vertex + np.int32(first_vertex[k]))
            # Row b of `bands`: the slots of band b in every lattice, as (first, last + 1) pairs.
            bands += [lattice.first_slot[:-1] + first_slot[k], lattice.first_slot[1:] + first_slot[k]]
        width = -(-labels // LANES) * LANES
        return cls(
            lattices, first_slot, first_vertex, corners, width, slots.reshape(-1), np.concatenate(vertices),
            weights.reshape(-1), own, np.stack(bands, axis=1) if bands else np.zeros((-(-count // BAND), 0), np.int64),
            *(_aligned(rows * width) for rows in (first_slot[-1], first_vertex[-1], first_vertex[-1])),
        )  # fmt: skip

    def blur(self) -> None:
        for k, lattice in enumerate(self.lattices):
            slots, rows = (slice(first[k] * self.width, first[k + 1] * self.width)
                           for first in (self.first_slot, self.first_vertex))  # fmt: skip
            blur(lattice, self.width, self.partial[slots], self.near[rows], self.far[rows])


def _aligned(size: int) -> NDArray[np.float32]:
    # Float32 whose first is the first of a cache line.
    block: NDArray[np.float32] = memory.empty((size + 16,), np.float32)
    skip = -(block.ctypes.data // 4) % 16
    return block[skip : skip + size]
