"""The permutohedral lattice: Gaussian filtering of values at scattered points of a space of few dimensions.

Adams, Baek and Davis, "Fast high-dimensional filtering using the permutohedral lattice" (Eurographics 2010). A point
lies in a simplex of d + 1 lattice vertices; its values are spread over them by barycentric weights, blurred along
the d + 1 axes of the lattice by [1 2 1], and read back by the same weights.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.dense_crf._lattice_kernels import (
    blur_axis,
    compute_own_share,
    embed,
    find_neighbors,
    gather_vertices,
    merge_vertices,
    read,
    spread,
)  # fmt: skip
from depthcli.core import memory
from depthcli.kernels.lanes import LANES

BAND = 16384  # points that one thread processes with one table of vertices, which fits into the cache
_MAX_DIMENSIONS = 8  # of any features here; the remainder of a vertex must fit into 4 bits of its key


@dataclass(frozen=True)
class Lattice:
    """The lattice vertices around N points.

    Points are divided into bands of equal length. Every band has its own *slots*, one for each of its vertices, so that
    no two threads write to the same memory and the order of sums does not depend on the number of threads.

    Attributes
    ----------
    slots : (N, d + 1) int32, the vertices of a point's simplex, as slots
    weights : (N, d + 1) float32, their barycentric weights; sum 1
    vertex : (T,) int32, vertex of every slot
    first_slot : (B + 1,) int64, slots of band b are ``first_slot[b] .. first_slot[b + 1] - 1``
    order, first : (T,) int32 and (V + 1,) int64, slots of vertex v are ``order[first[v] : first[v + 1]]``, ascending
    neighbors : (d + 1, 2, V) int32, the two neighbors of a vertex along every axis; V where there is none
    """

    slots: NDArray[np.int32]
    weights: NDArray[np.float32]
    vertex: NDArray[np.int32]
    first_slot: NDArray[np.int64]
    order: NDArray[np.int32]
    first: NDArray[np.int64]
    neighbors: NDArray[np.int32]

    @classmethod
    def of(cls, features: NDArray[np.float32]) -> Lattice:
        """Return the lattice around the points whose coordinates are ``features``.

        Parameters
        ----------
        features : (N, d) float32, finite, 1 <= d <= 8, in units of the Gaussian's standard deviation

        Raises
        ------
        ValueError
            For other shapes, values that are not finite, or features that span more lattice cells than 63 bits can
            number (more than some hundred standard deviations along each of six axes).
        """
        count, d = features.shape
        if not 1 <= d <= _MAX_DIMENSIONS:
            raise ValueError(f"want 1 to {_MAX_DIMENSIONS} features per point, got {d}")
        bands = -(-count // BAND)
        low, high = (features.min(axis=0), features.max(axis=0)) if count else np.zeros((2, d), np.float32)
        if not (np.isfinite(low) & np.isfinite(high)).all():
            raise ValueError("features must be finite")
        shifts = _bits(low.astype(np.float64), high.astype(np.float64))
        slots: NDArray[np.int32] = memory.empty((count, d + 1), np.int32)
        weights: NDArray[np.float32] = memory.empty((count, d + 1), np.float32)
        sizes = np.zeros(bands, np.int64)
        capacity = 8192
        while True:  # a band with more vertices than there is room for gives their number, and all begin again
            keys = np.empty((max(bands, 1), capacity), np.uint64)
            embed(features, _scales(d), shifts, BAND, slots, weights, keys, sizes)
            if bands == 0 or sizes.max() <= capacity:
                break
            capacity = int(sizes.max()) + 16
        first_slot = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
        vertex, own = np.empty(int(first_slot[-1]), np.int32), np.empty(int(first_slot[-1]), np.uint64)
        table, place, n_vertices = merge_vertices(keys, sizes, vertex, own, first_slot)
        slots += np.repeat(first_slot[:-1], BAND)[:count, None].astype(np.int32)
        counts = np.bincount(vertex, minlength=n_vertices)
        order = np.argsort(vertex, kind="stable").astype(np.int32)
        first = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        neighbors = np.empty((d + 1, 2, n_vertices), np.int32)
        find_neighbors(own, table, place, shifts, neighbors)
        return cls(slots, weights, vertex, first_slot, order, first, neighbors)

    @property
    def vertices(self) -> int:
        """Number V of vertices."""
        return int(self.first.size - 1)

    def own_share(self, density: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the weight of every point's own value in its filtered value, (N,) float32.

        Two vertices of one simplex, k steps apart in it, lie one step back along k axes, or one step forward along
        all others; this gives the product of the blur's factors if all vertices between exist. Whether they do is
        looked up only where the share is above a twentieth of ``density`` (N,), the filter's response to ones.
        """
        d = self.slots.shape[1] - 1
        steps = np.arange(d + 1)
        share = 0.5**steps + 0.5 ** (d + 1 - steps)
        share[0] = 1 + 2 * 0.5 ** (d + 1)
        factors = share[np.abs(steps[:, None] - steps[None, :])].astype(np.float32)
        result = np.empty(len(self.weights), np.float32)
        compute_own_share(self.slots, self.vertex, self.weights, self.neighbors, factors, density, result)
        return result

    def filter(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return (N, C) float32 ``values`` blurred by a Gaussian whose value at distance 0 is about ``1 + 2^-d``."""
        width = -(-values.shape[1] // LANES) * LANES
        partial, near, far = (memory.empty((rows * width,), np.float32)
                              for rows in (self.vertex.size, self.vertices + 1, self.vertices + 1))  # fmt: skip
        result = np.empty(values.shape, np.float32)
        spread(values, self.slots, self.weights, self.first_slot, BAND, partial.reshape(-1, width))
        blur(self, width, partial, near, far)
        read(near.reshape(-1, width), self.slots, self.vertex, self.weights, result)
        return result


def blur(
    lattice: Lattice, width: int, partial: NDArray[np.float32], near: NDArray[np.float32], far: NDArray[np.float32]
) -> None:
    """Add up the values in slots by vertex, blur them, and write them to ``near``.

    Parameters
    ----------
    lattice : with T slots and V vertices
    width : number of values per row, a multiple of the number of lanes
    partial : T rows, the values in slots
    near : V + 1 rows, of which the last becomes 0, the values of no vertex
    far : V + 1 rows of scratch memory
    """
    steps = len(lattice.neighbors)
    source, target = (near, far) if steps % 2 == 0 else (far, near)
    end = lattice.vertices * width
    source[end : end + width] = target[end : end + width] = 0
    gather_vertices(partial, lattice.order, lattice.first, source, width)
    for axis in range(steps):
        blur_axis(source, lattice.neighbors[axis, 0], lattice.neighbors[axis, 1], target, width)
        source, target = target, source


def _scales(d: int) -> NDArray[np.float64]:
    # Makes splatting, blurring and slicing together a Gaussian of standard deviation 1 (Adams et al., section 3).
    i = np.arange(d)
    scales: NDArray[np.float64] = np.sqrt(2.0 / 3.0) * (d + 1) / np.sqrt((i + 1.0) * (i + 2.0))
    return scales


def _bits(low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.int64]:
    # (d, 2) int64: offset and bit position of every coordinate in a vertex's key. A vertex is (d + 1) q + r, with the
    # same r in all coordinates, which sum to 0: it is determined by r and q of the first d coordinates.
    d = low.size
    low, high = low * _scales(d), high * _scales(d)
    shifts = np.empty((d, 2), np.int64)
    at = 4
    for i in range(d):
        # Coordinate i is the sum of features i, i + 1, ... less i times feature i - 1.
        lower, upper = low[i:].sum(), high[i:].sum()
        if i:
            lower, upper = lower - i * high[i - 1], upper - i * low[i - 1]
        first, last = int(np.floor(lower / (d + 1))) - 4, int(np.ceil(upper / (d + 1))) + 4
        shifts[i] = -first, at
        at += (last - first + 1).bit_length()
        if at > 63:
            raise ValueError("features span too many standard deviations for the lattice")
    return shifts
