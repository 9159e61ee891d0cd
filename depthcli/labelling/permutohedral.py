"""The permutohedral lattice: Gaussian filtering of values that lie anywhere in a space of few dimensions.

Adams, Baek and Davis, "Fast high-dimensional filtering using the permutohedral lattice" (Eurographics 2010). A point
lies in a simplex of d + 1 lattice vertices; its values are spread over them by barycentric weights, blurred along
the d + 1 axes of the lattice by [1 2 1], and read back by the same weights.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.core import memory
from depthcli.kernels.jit import jit, parallel_jit, prange

BAND = 16384  # points that share one table of vertices: few enough for the cache, and the unit of parallel work
MOST_DIMENSIONS = 8


@dataclass(frozen=True)
class Lattice:
    """The vertices that N points touch.

    Points come in bands of equal length. Every band has its own *slots*, one a vertex it touches, into which it
    spreads alone: no two threads write to one place, and sums are taken in one order whatever the number of threads.

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
        """Build it.

        Parameters
        ----------
        features : (N, d) float32, finite, 1 <= d <= 8, in units of the Gaussian's standard deviation

        Raises
        ------
        ValueError
            For other shapes, values that are not finite, or features that span more lattice cells than 63 bits tell
            apart (more than some hundred standard deviations along each of six axes).
        """
        count, d = features.shape
        if not 1 <= d <= MOST_DIMENSIONS:
            raise ValueError(f"want 1 to {MOST_DIMENSIONS} features a point, got {d}")
        low = features.min(axis=0) if count else np.zeros(d, np.float32)
        high = features.max(axis=0) if count else np.zeros(d, np.float32)
        if not (np.isfinite(low).all() and np.isfinite(high).all()):
            raise ValueError("features must be finite")
        shifts = _bits(low.astype(np.float64), high.astype(np.float64))
        bands = -(-count // BAND)
        slots = np.empty((count, d + 1), np.int32)
        weights = np.empty((count, d + 1), np.float32)
        keys: NDArray[np.uint64] = np.zeros((max(bands, 1), 1), np.uint64)
        sizes = np.zeros(bands, np.int64)
        most = 8192
        while True:  # a band that finds more vertices than there is room for says how many, and all begin again
            keys = np.empty((max(bands, 1), most), np.uint64)
            _embed(features, _scales(d), shifts, BAND, slots, weights, keys, sizes)
            if bands == 0 or sizes.max() <= most:
                break
            most = int(sizes.max()) + 16
        first_slot = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
        total = int(first_slot[-1])
        vertex = np.empty(total, np.int32)
        table, place, found = _merge(keys, sizes, vertex, slots, first_slot, BAND)
        counts = np.bincount(vertex, minlength=found)
        order = np.argsort(vertex, kind="stable").astype(np.int32)
        first = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        own = np.empty(found, np.uint64)
        own[vertex] = np.concatenate([keys[b, : sizes[b]] for b in range(bands)]) if bands else own
        neighbors = np.empty((d + 1, 2, found), np.int32)
        _find_neighbors(own, table, place, shifts, neighbors)
        return cls(slots, weights, vertex, first_slot, order, first, neighbors)

    @property
    def vertices(self) -> int:
        """V."""
        return int(self.first.size - 1)

    def own_share(self, density: NDArray[np.float32]) -> NDArray[np.float32]:
        """(N,) float32: how much of a point's own value comes back to it by ``filter``.

        Two vertices of one simplex, k steps apart in it, lie one step back along k axes, or one step forward along
        all others: the product of the blur's factors follows, where all vertices on the way exist. That is looked up
        only where the share matters: above a twentieth of ``density`` (N,), the filter's response to ones.
        """
        d = self.slots.shape[1] - 1
        apart = np.arange(d + 1)
        share = 0.5**apart + 0.5 ** (d + 1 - apart)
        share[0] = 1 + 2 * 0.5 ** (d + 1)
        factors = share[np.abs(apart[:, None] - apart[None, :])].astype(np.float32)
        result = np.empty(len(self.weights), np.float32)
        _own_share(self.slots, self.vertex, self.weights, self.neighbors, factors, density, result)
        return result

    def filter(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """Blur (N, C) float32 ``values``; the Gaussian's value at distance 0 is about ``1 + 2^-d``."""
        width = values.shape[1]
        partial = memory.empty((self.vertex.size * width,), np.float32)
        near: NDArray[np.float32] = memory.empty(((self.vertices + 1) * width,), np.float32)
        far: NDArray[np.float32] = memory.empty(((self.vertices + 1) * width,), np.float32)
        result = np.empty(values.shape, np.float32)
        spread(values, self.slots, self.weights, self.first_slot, BAND, partial.reshape(-1, width))
        blur(self, width, partial, near, far)
        read(near.reshape(-1, width), self.slots, self.vertex, self.weights, result)
        return result


def blur(
    lattice: Lattice, width: int, partial: NDArray[np.float32], near: NDArray[np.float32], far: NDArray[np.float32]
) -> None:
    """Add the slots (T rows of ``width``) up into vertices and blur those.

    The result is in ``near``, V + 1 rows, the last one 0.
    """
    steps = len(lattice.neighbors)
    source, target = (near, far) if steps % 2 == 0 else (far, near)
    source[-width:] = 0
    target[-width:] = 0
    _gather(partial, lattice.order, lattice.first, source, width)
    for axis in range(steps):
        _blur(source, lattice.neighbors[axis, 0], lattice.neighbors[axis, 1], target, width)
        source, target = target, source


def _scales(d: int) -> NDArray[np.float64]:
    # Makes splatting, blurring and slicing together a Gaussian of standard deviation 1 (Adams et al., section 3).
    i = np.arange(d)
    scales: NDArray[np.float64] = np.sqrt(2.0 / 3.0) * (d + 1) / np.sqrt((i + 1.0) * (i + 2.0))
    return scales


def _bits(low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.int64]:
    """(d, 2) int64: offset and bit position of every coordinate in a vertex's key.

    A vertex is (d + 1) q + r, the same r in all coordinates, which sum to 0: q of the first d of them and r say all.
    """
    d = low.size
    low, high = low * _scales(d), high * _scales(d)
    shifts = np.empty((d, 2), np.int64)
    at = 4
    for i in range(d):
        # Coordinate i is the sum of features i, i + 1, ... less i times feature i - 1.
        least, most = low[i:].sum(), high[i:].sum()
        if i:
            least, most = least - i * high[i - 1], most - i * low[i - 1]
        first, last = int(np.floor(least / (d + 1))) - 4, int(np.ceil(most / (d + 1))) + 4
        shifts[i] = -first, at
        at += (last - first + 1).bit_length()
        if at > 63:
            raise ValueError("features span too many standard deviations for the lattice")
    return shifts


@jit
def _find(table: Any, place: Any, key: Any) -> Any:
    """Position of ``key`` in an open-addressed table, or of the free cell where it belongs."""
    mask = np.uint64(table.size - 1)
    h = key * np.uint64(0x9E3779B97F4A7C15)
    at = (h ^ (h >> np.uint64(29))) & mask
    while place[at] >= 0 and table[at] != key:
        at = (at + np.uint64(1)) & mask
    return np.int64(at)


@parallel_jit
def _embed(features: Any, scales: Any, shifts: Any, band: int, slots: Any, weights: Any, keys: Any, sizes: Any) -> None:
    """Simplex and barycentric weights of every point; slots are numbered from 0 in every band.

    ``sizes`` gets the number of vertices of each band, also where ``keys`` has no room for them.
    """
    count, d = features.shape
    for b in prange(sizes.size):
        capacity = 4096
        while capacity < 2 * keys.shape[1]:
            capacity *= 2
        table = np.empty(capacity, np.uint64)
        place = np.full(capacity, -1, np.int32)
        elevated = np.empty(d + 1, np.float64)
        base = np.empty(d + 1, np.int64)
        rank = np.empty(d + 1, np.int64)
        share = np.empty(d + 2, np.float64)
        found = 0
        for n in range(b * band, min(count, (b + 1) * band)):
            total = 0.0
            for j in range(d, 0, -1):
                f = np.float64(features[n, j - 1]) * scales[j - 1]
                elevated[j] = total - j * f
                total += f
            elevated[0] = total
            # The nearest point whose coordinates are multiples of d + 1; where their sum is not 0, some move on.
            off = 0
            for i in range(d + 1):
                base[i] = np.int64(np.floor(elevated[i] / (d + 1) + 0.5))
                off += base[i]
                rank[i] = 0
            for i in range(d):
                rest = elevated[i] - base[i] * (d + 1)
                for j in range(i + 1, d + 1):
                    if rest < elevated[j] - base[j] * (d + 1):
                        rank[i] += 1
                    else:
                        rank[j] += 1
            for i in range(d + 1):
                rank[i] += off
                if rank[i] < 0:
                    rank[i] += d + 1
                    base[i] += 1
                elif rank[i] > d:
                    rank[i] -= d + 1
                    base[i] -= 1
            share[:] = 0.0
            for i in range(d + 1):
                rest = elevated[i] / (d + 1) - base[i]
                share[d - rank[i]] += rest
                share[d + 1 - rank[i]] -= rest
            share[0] += 1.0 + share[d + 1]
            for r in range(d + 1):
                key = np.uint64(r)
                for i in range(d):
                    q = base[i] - (1 if rank[i] > d - r else 0) + shifts[i, 0]
                    key |= np.uint64(q) << np.uint64(shifts[i, 1])
                at = _find(table, place, key)
                if place[at] < 0:
                    if 2 * found >= capacity:
                        # Only the count matters now: it tells how much room the next try needs.
                        found += 1
                        continue
                    table[at] = key
                    place[at] = found
                    if found < keys.shape[1]:
                        keys[b, found] = key
                    found += 1
                slots[n, r] = place[at]
                weights[n, r] = np.float32(share[r])
        sizes[b] = found


@jit
def _merge(keys: Any, sizes: Any, vertex: Any, slots: Any, first_slot: Any, band: int) -> Any:
    """Number the vertices of all bands; slots become indices into ``vertex``. Hash table and number of vertices."""
    total = first_slot[-1]
    capacity = 1024
    while capacity < 2 * total:
        capacity *= 2
    table = np.empty(capacity, np.uint64)
    place = np.full(capacity, -1, np.int32)
    found = 0
    for b in range(sizes.size):
        for k in range(sizes[b]):
            at = _find(table, place, keys[b, k])
            if place[at] < 0:
                table[at] = keys[b, k]
                place[at] = found
                found += 1
            vertex[first_slot[b] + k] = place[at]
        rows = slots[b * band : (b + 1) * band]
        for i in range(rows.shape[0]):
            for j in range(rows.shape[1]):
                rows[i, j] += np.int32(first_slot[b])
    return table, place, found


@parallel_jit
def _find_neighbors(own: Any, table: Any, place: Any, shifts: Any, neighbors: Any) -> None:
    axes, _, vertices = neighbors.shape
    d = axes - 1
    for v in prange(vertices):
        q = np.empty(d, np.int64)
        r: Any = np.int64(own[v] & np.uint64(15))
        for side in range(2):
            step = 1 - 2 * side
            for axis in range(axes):
                turn = r + step
                carry = 0
                if turn > d:
                    turn, carry = 0, 1
                elif turn < 0:
                    turn, carry = d, -1
                key = np.uint64(turn)
                for i in range(d):
                    q[i] = np.int64(own[v] >> np.uint64(shifts[i, 1]))
                    if i + 1 < d:
                        q[i] &= (np.int64(1) << (shifts[i + 1, 1] - shifts[i, 1])) - 1
                    q[i] += carry - (step if i == axis else 0)
                    key |= np.uint64(q[i]) << np.uint64(shifts[i, 1])
                at = _find(table, place, key)
                neighbors[axis, side, v] = place[at] if place[at] >= 0 else vertices


@parallel_jit
def spread(values: Any, slots: Any, weights: Any, first_slot: Any, band: int, partial: Any) -> None:
    """Sums of (N, C) values into (T, C) slots."""
    count, corners = slots.shape
    for b in prange(first_slot.size - 1):
        partial[first_slot[b] : first_slot[b + 1]] = np.float32(0.0)
        for n in range(b * band, min(count, (b + 1) * band)):
            source = values[n]
            for c in range(corners):
                w = weights[n, c]
                target = partial[slots[n, c]]
                for k in range(source.size):
                    target[k] += w * source[k]


@parallel_jit
def read(values: Any, slots: Any, vertex: Any, weights: Any, result: Any) -> None:
    """(N, C) from (V + 1, C) vertices."""
    count, corners = slots.shape
    for n in prange(count):
        target = result[n]
        target[:] = np.float32(0.0)
        for c in range(corners):
            w = weights[n, c]
            source = values[vertex[slots[n, c]]]
            for k in range(target.size):
                target[k] += w * source[k]


@parallel_jit
def _own_share(slots: Any, vertex: Any, weights: Any, neighbors: Any, factors: Any, density: Any, result: Any) -> None:
    axes = factors.shape[0]
    for n in prange(result.size):
        total = np.float32(0.0)
        for i in range(axes):
            for j in range(axes):
                total += weights[n, i] * factors[i, j] * weights[n, j]
        if total > np.float32(0.05) * density[n]:
            total = np.float32(0.0)
            for i in range(axes):
                for j in range(axes):
                    for side in range(3):
                        reached = _reached(slots[n], vertex, neighbors, i, j, side - 1)
                        total += weights[n, i] * reached * weights[n, j]
        result[n] = total


@jit
def _reached(slots: Any, vertex: Any, neighbors: Any, start: int, stop: int, turn: int) -> Any:
    """What the blur carries from one vertex of a simplex to another.

    Between the two lie the axes of the steps from each vertex of the simplex to the next. Along those the way takes
    one step, plus ``turn`` steps along every axis, which lead nowhere.
    """
    axes = neighbors.shape[0]
    at = vertex[slots[start]]
    low, high, sign = (start, stop, 1) if start < stop else (stop, start, -1)
    factor = np.float32(1.0)
    for axis in range(axes):
        step = turn
        for r in range(low, high):
            if neighbors[axis, 0, vertex[slots[r]]] == vertex[slots[r + 1]]:
                step += sign
        if step > 1 or step < -1:
            return np.float32(0.0)
        if step != 0:
            at = neighbors[axis, 0 if step > 0 else 1, at]
            factor *= np.float32(0.5)
            if at == neighbors.shape[2]:
                return np.float32(0.0)
    return factor


@parallel_jit
def _gather(partial: Any, order: Any, first: Any, values: Any, width: int) -> None:
    # Indices without a sign: numba tests others for being negative, a test that stops SIMD.
    for v in prange(first.size - 1):
        to = np.uint64(v * width)
        at = np.uint64(order[first[v]] * width)
        for k in range(width):
            values[to + np.uint64(k)] = partial[at + np.uint64(k)]
        for s in range(first[v] + 1, first[v + 1]):
            at = np.uint64(order[s] * width)
            for k in range(width):
                values[to + np.uint64(k)] += partial[at + np.uint64(k)]


@parallel_jit
def _blur(source: Any, left: Any, right: Any, target: Any, width: int) -> None:
    half = np.float32(0.5)
    for v in prange(left.size):
        at, low, high = np.uint64(v * width), np.uint64(left[v] * width), np.uint64(right[v] * width)
        for k in range(width):
            ends = source[low + np.uint64(k)] + source[high + np.uint64(k)]
            target[at + np.uint64(k)] = source[at + np.uint64(k)] + half * ends
