"""Mean field inference in a fully connected CRF (Kraehenbuhl and Koltun, NIPS 2011).

The energy of labels x is ``sum_i U_i(x_i) + sum_{i<j} mu(x_i, x_j) sum_m w_m n_i n_j k_m(f_i, f_j)`` with Gaussian
kernels k_m of features f and the truncated linear ``mu(l, l') = min(|l - l'|, T)``. Kernels are normalized
symmetrically, ``n_i = (sum_j k_m(f_i, f_j))^-1/2``, so that a weight has the same effect at points with many and with
few close points.
One step of mean field is

    Q_i(l) ~ exp(-U_i(l) - sum_l' mu(l, l') sum_m w_m sum_{j != i} n_i n_j k_m(f_i, f_j) Q_j(l'))

whose inner sums over all j are Gaussian filters on a permutohedral lattice: linear in points; O(L log T) in labels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.dense_crf._mean_field_kernels import join_lattices, update
from depthcli.algorithms.dense_crf.permutohedral import BAND, Lattice, blur
from depthcli.core import memory
from depthcli.kernels.lanes import LANES


@dataclass(frozen=True)
class GaussianKernel:
    """One Gaussian kernel, by which close points influence each other.

    Attributes
    ----------
    features : (N, d) float32, 1 <= d <= 8, each divided by its standard deviation
    weight : factor w_m of the kernel in the energy, >= 0
    """

    features: NDArray[np.float32]
    weight: float


def mean_field(
    unary: NDArray[np.float32],
    kernels: Sequence[GaussianKernel],
    truncation: int,
    iterations: int = 5,
) -> NDArray[np.float32]:
    """Return approximate marginals of every label at every point.

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
    if not (np.isfinite(unary.min(initial=0)) and np.isfinite(unary.max(initial=0))):
        raise ValueError("unary energies must be finite")
    q: NDArray[np.float32] = memory.empty((count, labels), np.float32)
    joined = _JoinedLattices.of([kernel for kernel in kernels if kernel.weight > 0 and iterations], count)
    corners, slots, weights = joined.slots.shape[1], joined.slots.reshape(-1), joined.weights.reshape(-1)
    width = -(-labels // LANES) * LANES
    n_rows = sum(lattice.vertices + 1 for lattice in joined.lattices)
    partial, near, far = (_aligned(rows * width) for rows in (joined.vertex.size, n_rows, n_rows))
    energies, marginals = np.ascontiguousarray(unary).reshape(-1), q.reshape(-1)
    last = iterations if corners else 0
    for step in range(last + 1):
        slot = row = 0
        for lattice in joined.lattices if step else ():
            blur(lattice, width, partial[slot * width :], near[row * width :], far[row * width :])
            slot, row = slot + lattice.vertex.size, row + lattice.vertices + 1
        update(
            energies, marginals, labels, near, slots, joined.vertex, weights, corners, joined.own,
            min(truncation, labels), joined.bands, width, step > 0, step < last, partial,
        )  # fmt: skip
    return q


@dataclass(frozen=True)
class _JoinedLattices:
    # The lattices of all kernels side by side, for one pass over the points.
    #
    # slots, weights: (N, C), columns are the corners of all lattices. The weights include the normalization and the
    #     square root of the kernel's weight, so that spreading and reading with the same weights and adding all
    #     columns gives the message
    # own: (N,), a point's message to itself
    # vertex: (T,) row of every slot in arrays of all vertices, where each lattice is followed by a row of zeros
    # bands: (B, 2 K), row b holds the slots of band b in each of the K lattices, as first and last + 1

    lattices: tuple[Lattice, ...]
    slots: NDArray[np.int32]
    weights: NDArray[np.float32]
    own: NDArray[np.float32]
    vertex: NDArray[np.int32]
    bands: NDArray[np.int64]

    @classmethod
    def of(cls, kernels: Sequence[GaussianKernel], count: int) -> _JoinedLattices:
        lattices = tuple(Lattice.of(kernel.features) for kernel in kernels)
        corners = sum(lattice.slots.shape[1] for lattice in lattices)
        slots: NDArray[np.int32] = memory.empty((count, corners), np.int32)
        weights: NDArray[np.float32] = memory.empty((count, corners), np.float32)
        own = np.zeros(count, np.float32)
        vertex, bands = [np.zeros(0, np.int32)], [np.zeros((-(-count // BAND), 0), np.int64)]
        slot = row = column = 0
        for kernel, lattice in zip(kernels, lattices, strict=True):
            density = lattice.filter(np.ones((count, 1), np.float32))[:, 0]
            join_lattices(
                lattice.slots, lattice.weights, density, lattice.own_share(density), np.float32(kernel.weight),
                np.int32(slot), column, slots, weights, own,
            )  # fmt: skip
            vertex.append(lattice.vertex + np.int32(row))
            bands.append(np.stack([lattice.first_slot[:-1], lattice.first_slot[1:]], axis=1) + slot)
            slot, row = slot + lattice.vertex.size, row + lattice.vertices + 1
            column += lattice.slots.shape[1]
        return cls(lattices, slots, weights, own, np.concatenate(vertex), np.concatenate(bands, axis=1))


def _aligned(size: int) -> NDArray[np.float32]:
    # Float32 whose first is the first of a cache line.
    block: NDArray[np.float32] = memory.empty((size + 16,), np.float32)
    skip = -(block.ctypes.data // 4) % 16
    return block[skip : skip + size]
