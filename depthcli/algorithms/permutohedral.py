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
from depthcli.kernels.lanes import LANES, load, splat, store

BAND = 16384  # points that share one table of vertices: few enough for the cache, and the unit of parallel work
MOST_DIMENSIONS = 8
_TILE = 64  # points whose simplices are found together


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
        bands = -(-count // BAND)
        ends = np.zeros((2, bands, d), np.float32)
        _extremes(features, BAND, ends)
        if not np.isfinite(ends).all():
            raise ValueError("features must be finite")
        low, high = (ends[0].min(axis=0), ends[1].max(axis=0)) if count else np.zeros((2, d), np.float32)
        shifts = _bits(low.astype(np.float64), high.astype(np.float64))
        slots: NDArray[np.int32] = memory.empty((count, d + 1), np.int32)
        weights: NDArray[np.float32] = memory.empty((count, d + 1), np.float32)
        sizes = np.zeros(bands, np.int64)
        most = 8192
        while True:  # a band that finds more vertices than there is room for says how many, and all begin again
            keys = np.empty((max(bands, 1), most), np.uint64)
            _embed(features, _scales(d), shifts, BAND, slots, weights, keys, sizes)
            if bands == 0 or sizes.max() <= most:
                break
            most = int(sizes.max()) + 16
        first_slot = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
        vertex, own = np.empty(int(first_slot[-1]), np.int32), np.empty(int(first_slot[-1]), np.uint64)
        table, place, found = _merge(keys, sizes, vertex, own, first_slot)
        _renumber(slots, first_slot, BAND)
        counts = np.bincount(vertex, minlength=found)
        order = np.argsort(vertex, kind="stable").astype(np.int32)
        first = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
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
def _extremes(features: Any, band: int, ends: Any) -> None:
    """Smallest and largest feature of every band; not finite where any is not."""
    count, d = features.shape
    for b in prange(ends.shape[1]):
        for i in range(d):
            low = high = features[b * band, i]
            bad = False
            for n in range(b * band, min(count, (b + 1) * band)):
                f = features[n, i]
                bad |= not abs(f) < np.float32(np.inf)
                low, high = min(low, f), max(high, f)
            ends[0, b, i] = np.float32(np.nan) if bad else low
            ends[1, b, i] = high


@jit
def _steps(shifts: Any) -> Any:
    """What a key changes by along every axis, and what more where the last coordinate begins again."""
    d = shifts.shape[0]
    steps = np.ones(d + 1, np.uint64)
    wrap = -np.uint64(d + 1)
    for i in range(d):
        steps[i] -= np.uint64(1) << np.uint64(shifts[i, 1])
        wrap += np.uint64(1) << np.uint64(shifts[i, 1])
    return steps, wrap


@parallel_jit
def _embed(features: Any, scales: Any, shifts: Any, band: int, slots: Any, weights: Any, keys: Any, sizes: Any) -> None:
    """Simplex and barycentric weights of every point; slots are numbered from 0 in every band.

    ``sizes`` gets the number of vertices of each band, also where ``keys`` has no room for them.
    """
    count, d = features.shape
    size = d + 1
    for b in prange(sizes.size):
        capacity = 4096
        while capacity < 2 * keys.shape[1]:
            capacity *= 2
        table = np.empty(capacity, np.uint64)
        place = np.full(capacity, -1, np.int32)
        steps, _ = _steps(shifts)
        # Coordinate by coordinate, so that points are worked on side by side.
        elevated, base = np.zeros((size, _TILE), np.float64), np.zeros((size, _TILE), np.float64)
        rest, rank = np.zeros((size, _TILE), np.float64), np.zeros((size, _TILE), np.float64)
        total = np.zeros(_TILE, np.float64)
        at, inner = np.empty(size, np.int64), np.empty(size, np.float64)
        found = 0
        stop = min(count, (b + 1) * band)
        for first in range(b * band, stop, _TILE):
            points = min(_TILE, stop - first)
            total[:] = 0.0
            for j in range(d, 0, -1):
                up = elevated[j]
                for p in range(points):
                    f = np.float64(features[first + p, j - 1]) * scales[j - 1]
                    up[p] = total[p] - j * f
                    total[p] += f
            elevated[0] = total
            _nearest(elevated, base, rest, rank, total)
            for p in range(points):
                key = np.uint64(0)
                for i in range(size):
                    k = np.int64(rank[i, p])
                    at[k] = i
                    inner[k] = rest[i, p]
                    if i < d:
                        key += np.uint64(np.int64(base[i, p]) + shifts[i, 0]) << np.uint64(shifts[i, 1])
                n = first + p
                for r in range(size):
                    if r == 0:
                        share = inner[d] + (1.0 - inner[0])
                    else:
                        share = inner[d - r] - inner[size - r]
                        key += steps[at[size - r]]
                    weights[n, r] = np.float32(share)
                    cell = _find(table, place, key)
                    if place[cell] < 0:
                        if 2 * found >= capacity:
                            # Only the count matters now: it tells how much room the next try needs.
                            found += 1
                            continue
                        table[cell] = key
                        place[cell] = found
                        if found < keys.shape[1]:
                            keys[b, found] = key
                        found += 1
                    slots[n, r] = place[cell]
        sizes[b] = found


@jit
def _nearest(elevated: Any, base: Any, rest: Any, rank: Any, off: Any) -> None:
    """The vertex of remainder 0 of every point's simplex: ``base`` times d + 1, and what is left, in order of rank.

    It is the nearest point whose coordinates are multiples of d + 1; where their sum is not 0, some move on.
    ``rest`` is in units of d + 1, ``off`` scratch.
    """
    size = elevated.shape[0]
    part, most = 1.0 / size, np.float64(size - 1)
    off[:] = 0.0
    for i in range(size):
        from_, whole, left = elevated[i], base[i], rest[i]
        for p in range(off.size):
            whole[p] = np.floor(from_[p] * part + 0.5)
            left[p] = from_[p] * part - whole[p]
            off[p] += whole[p]
        rank[i] = off * 0.0
    for i in range(size):
        for j in range(i + 1, size):
            one, other, ranks, others = rest[i], rest[j], rank[i], rank[j]
            for p in range(off.size):
                less = 1.0 if one[p] < other[p] else 0.0
                ranks[p] += less
                others[p] += 1.0 - less
    for i in range(size):
        whole, left, ranks = base[i], rest[i], rank[i]
        for p in range(off.size):
            r = ranks[p] + off[p]
            turn = (1.0 if r < 0.0 else 0.0) - (1.0 if r > most else 0.0)
            ranks[p] = r + turn * (most + 1.0)
            whole[p] += turn
            left[p] -= turn


@jit
def _merge(keys: Any, sizes: Any, vertex: Any, own: Any, first_slot: Any) -> Any:
    """Number the vertices of all bands; hash table, and number of vertices, whose keys ``own`` begins with."""
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
                own[found] = keys[b, k]
                found += 1
            vertex[first_slot[b] + k] = place[at]
    return table, place, found


@parallel_jit
def _renumber(slots: Any, first_slot: Any, band: int) -> None:
    """Slots of a band become indices into all of them."""
    for b in prange(first_slot.size - 1):
        for n in range(b * band, min(slots.shape[0], (b + 1) * band)):
            for r in range(slots.shape[1]):
                slots[n, r] += np.int32(first_slot[b])


@parallel_jit
def _find_neighbors(own: Any, table: Any, place: Any, shifts: Any, neighbors: Any) -> None:
    axes, _, vertices = neighbors.shape
    steps, wrap = _steps(shifts)
    none = np.uint64(0)
    for v in prange(vertices):
        last = own[v] & np.uint64(15)
        up = wrap if last == np.uint64(axes - 1) else none
        down = wrap if last == none else none
        for axis in range(axes):
            for side in range(2):
                key = own[v] - steps[axis] - down if side else own[v] + steps[axis] + up
                at = _find(table, place, key)
                neighbors[axis, side, v] = place[at] if place[at] >= 0 else vertices


@parallel_jit
def spread(values: Any, slots: Any, weights: Any, first_slot: Any, band: int, partial: Any) -> None:
    """Sums of (N, C) values into (T, C) slots."""
    count, corners = slots.shape
    for b in prange(first_slot.size - 1):
        partial[first_slot[b] : first_slot[b + 1]] = np.float32(0.0)
        for n in range(b * band, min(count, (b + 1) * band)):
            for c in range(corners):
                w, to = weights[n, c], slots[n, c]
                for k in range(values.shape[1]):
                    partial[to, k] += w * values[n, k]


@parallel_jit
def read(values: Any, slots: Any, vertex: Any, weights: Any, result: Any) -> None:
    """(N, C) from (V + 1, C) vertices."""
    count, corners = slots.shape
    for n in prange(count):
        for k in range(result.shape[1]):
            result[n, k] = np.float32(0.0)
        for c in range(corners):
            w, at = weights[n, c], vertex[slots[n, c]]
            for k in range(result.shape[1]):
                result[n, k] += w * values[at, k]


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
    for v in prange(first.size - 1):
        to = v * width
        for k in range(0, width - LANES + 1, LANES):
            value = load(partial, order[first[v]] * width + k)
            for s in range(first[v] + 1, first[v + 1]):
                value += load(partial, order[s] * width + k)
            store(values, to + k, value)
        for k in range(width - width % LANES, width):
            values[to + k] = partial[order[first[v]] * width + k]
            for s in range(first[v] + 1, first[v + 1]):
                values[to + k] += partial[order[s] * width + k]


@parallel_jit
def _blur(source: Any, left: Any, right: Any, target: Any, width: int) -> None:
    half = np.float32(0.5)
    for v in prange(left.size):
        at, low, high = v * width, left[v] * width, right[v] * width
        for k in range(0, width - LANES + 1, LANES):
            store(target, at + k, load(source, at + k) + splat(half) * (load(source, low + k) + load(source, high + k)))
        for k in range(width - width % LANES, width):
            target[at + k] = source[at + k] + half * (source[low + k] + source[high + k])
