"""The permutohedral lattice: Gaussian filtering of values at scattered points in a space of few dimensions.

Adams, Baek and Davis, "Fast high-dimensional filtering using the permutohedral lattice" (Eurographics 2010). A point is
in a simplex of d + 1 lattice vertices. Its values are spread over them with barycentric weights, blurred along the
d + 1 axes of the lattice by [1 2 1], and read back with the same weights.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from depthcli.core import memory
from depthcli.core.maps import Doubles, Floats, Ints
from depthcli.kernels.jit import empty, helper, jit, run_bands, zeros

BAND = 16384  # points per table of vertices: the table fits into the cache
_TILE = 64  # points whose simplices are computed together: their coordinates stay in the first-level cache


@dataclass(frozen=True)
class Lattice:
    """The lattice vertices around N points.

    Points are divided into bands of equal length. Every band has its own *slots*, one for each of its vertices.
    Therefore no two threads write to the same memory, and the order of sums does not depend on the number of threads.
    """

    slots: Ints  # (N, d + 1) int32, slots of the vertices of a point's simplex
    weights: Floats  # (N, d + 1) float32, barycentric weights of these vertices; sum 1
    vertex: Ints  # (T,) int32, vertex of every slot
    first_slot: NDArray[np.int64]  # (B + 1,) int64, slots of band b are ``first_slot[b] .. first_slot[b + 1] - 1``
    # (T,) int32 and (V + 1,) int64: slots of vertex v are ``order[first[v] : first[v + 1]]``, ascending
    order: Ints
    first: NDArray[np.int64]
    # (d + 1, 2, V) int32, the two neighbors of a vertex along every axis; V = none
    neighbors: Ints

    @classmethod
    def of(cls, features: Floats) -> Lattice:
        """Return the lattice around points with ``features`` (N, d), d <= 8, in standard deviations of the Gaussian.

        ValueError: features are not finite, or span more lattice cells than 63 bits can number (more than a few hundred
        standard deviations along each of six axes).
        """
        count, d = features.shape
        bands = -(-count // BAND)
        low, high = (features.min(axis=0), features.max(axis=0)) if count else np.zeros((2, d), np.float32)
        if not (np.isfinite(low) & np.isfinite(high)).all():
            raise ValueError("features must be finite")
        # With these scales, splatting, blurring and slicing are a Gaussian of standard deviation 1 (section 3).
        i = np.arange(d)
        scales = np.sqrt(2.0 / 3.0) * (d + 1) / np.sqrt((i + 1.0) * (i + 2.0))
        shifts = _bits(low * scales, high * scales)
        slots: Ints = memory.empty((count, d + 1), np.int32)
        weights: Floats = memory.empty((count, d + 1), np.float32)
        sizes = np.zeros(bands, np.int64)
        capacity = 8192
        while True:  # repeat with more room if a band has more vertices than ``capacity``
            keys = np.empty((max(bands, 1), capacity), np.uint64)
            run_bands(_embed, sizes.size, features, scales, shifts, BAND, slots, weights, keys, sizes)
            if bands == 0 or sizes.max() <= capacity:
                break
            capacity = int(sizes.max()) + 16
        first_slot = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
        vertex, own = np.empty(int(first_slot[-1]), np.int32), np.empty(int(first_slot[-1]), np.uint64)
        table, place, n_vertices = _merge_vertices(keys, sizes, vertex, own, first_slot)
        slots += np.repeat(first_slot[:-1], BAND)[:count, None].astype(np.int32)
        counts = np.bincount(vertex, minlength=n_vertices)
        order = np.argsort(vertex, kind="stable").astype(np.int32)
        first = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        neighbors = np.empty((d + 1, 2, n_vertices), np.int32)
        run_bands(_find_neighbors, neighbors.shape[2], own, table, place, shifts, neighbors)
        return cls(slots, weights, vertex, first_slot, order, first, neighbors)

    @property
    def vertices(self) -> int:
        """Number V of vertices."""
        return int(self.first.size - 1)

    def own_share(self, density: Floats) -> Floats:
        """Return the weight of every point's own value in its filtered value, (N,) float32.

        Two vertices of a simplex that are k steps apart are one step back along k axes, or one step forward along all
        others. If all vertices between them exist, the blur's factors along these paths give the share. Missing
        vertices are looked up only if the share is above a twentieth of ``density`` (N,), the filter's response to
        ones.
        """
        d = self.slots.shape[1] - 1
        steps = np.arange(d + 1)
        share = 0.5**steps + 0.5 ** (d + 1 - steps)
        share[0] = 1 + 2 * 0.5 ** (d + 1)
        factors = share[np.abs(steps[:, None] - steps[None, :])].astype(np.float32)
        result = np.empty(len(self.weights), np.float32)
        run_bands(
            _compute_own_share, result.size, self.slots, self.vertex, self.weights, self.neighbors, factors, density,
            result,
        )  # fmt: skip
        return result

    def filter(self, values: Floats) -> Floats:
        """Return (N, C) float32 ``values``, blurred by a Gaussian with value about ``1 + 2^-d`` at distance 0."""
        width = values.shape[1]
        sizes = (self.vertex.size, self.vertices + 1, self.vertices + 1)
        partial, near, far = (memory.empty((rows * width,), np.float32) for rows in sizes)
        result = np.empty(values.shape, np.float32)
        run_bands(
            _spread, self.first_slot.size - 1, values, self.slots, self.weights, self.first_slot, BAND,
            partial.reshape(-1, width),
        )  # fmt: skip
        blur(self, width, partial, near, far)
        run_bands(_read, len(self.slots), near.reshape(-1, width), self.slots, self.vertex, self.weights, result)
        return result


def blur(lattice: Lattice, width: int, partial: Floats, near: Floats, far: Floats) -> None:
    """Sum the T rows of values in slots by vertex, blur the sums, and write them to the V + 1 rows of ``near``.

    The last row becomes 0, for missing vertices. ``far`` is scratch memory of the same size.
    """
    steps = len(lattice.neighbors)
    source, target = (near, far) if steps % 2 == 0 else (far, near)
    end = lattice.vertices * width
    source[end : end + width] = target[end : end + width] = 0
    run_bands(_gather_vertices, lattice.first.size - 1, partial, lattice.order, lattice.first, source, width)
    for axis in range(steps):
        run_bands(
            _blur_axis, lattice.neighbors[axis, 0].size, source, lattice.neighbors[axis, 0],
            lattice.neighbors[axis, 1], target, width,
        )  # fmt: skip
        source, target = target, source


def _bits(low: Doubles, high: Doubles) -> NDArray[np.int64]:
    # Return offset and bit position of every coordinate in a vertex's key, (d, 2) int64. A vertex is (d + 1) q + r,
    # with the same r in all coordinates. Its coordinates sum to 0, so r and q of the first d coordinates determine it.
    # r takes 4 bits.
    d = low.size
    shifts = np.empty((d, 2), np.int64)
    at = 4
    for i in range(d):
        # Coordinate i is the sum of features i, i + 1, ... minus i times feature i - 1.
        lower, upper = low[i:].sum(), high[i:].sum()
        if i:
            lower, upper = lower - i * high[i - 1], upper - i * low[i - 1]
        first, last = int(np.floor(lower / (d + 1))) - 4, int(np.ceil(upper / (d + 1))) + 4
        shifts[i] = -first, at
        at += (last - first + 1).bit_length()
        if at > 63:
            raise ValueError("features span too many standard deviations for the lattice")
    return shifts


@helper
def _find(table, place, key):
    # Return the position of ``key`` in an open-addressed hash table, or the free cell for it.
    mask = np.uint64(table.size - 1)
    h = key * np.uint64(0x9E3779B97F4A7C15)
    at = (h ^ (h >> np.uint64(29))) & mask
    while place[at] >= 0 and table[at] != key:
        at = (at + np.uint64(1)) & mask
    return np.int64(at)


@helper
def _steps(shifts):
    # Return the change of a key along every axis, and the additional change when the remainder wraps around.
    d = shifts.shape[0]
    steps = np.ones(d + 1, np.uint64)
    wrap = -np.uint64(d + 1)
    for i in range(d):
        steps[i] -= np.uint64(1) << np.uint64(shifts[i, 1])
        wrap += np.uint64(1) << np.uint64(shifts[i, 1])
    return steps, wrap


@jit
def _embed(begin, end, features, scales, shifts, band, slots, weights, keys, sizes):
    # Find the simplex of every point. Write its vertices, as slots that count from 0 in every band, and its barycentric
    # weights. ``keys`` receives the vertices' keys, and ``sizes`` their number per band. If there is no room for all
    # keys of a band, its size is at least the room that the next try needs.
    count, d = features.shape
    size = d + 1
    for b in range(begin, end):
        capacity = 4096
        while capacity < 2 * keys.shape[1]:
            capacity *= 2
        table = empty(capacity, np.uint64)
        place = np.full(capacity, -1, np.int32)
        steps, _ = _steps(shifts)
        # Coordinate by coordinate, so that points are processed in vector lanes.
        elevated, base = zeros((size, _TILE), np.float64), zeros((size, _TILE), np.float64)
        rest, rank = zeros((size, _TILE), np.float64), zeros((size, _TILE), np.float64)
        total = zeros(_TILE, np.float64)
        at, inner = empty(size, np.int64), empty(size, np.float64)
        n_vertices = 0
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
                        if 2 * n_vertices >= capacity:
                            # Only the count matters now, as the room that the next try needs.
                            n_vertices += 1
                            continue
                        table[cell] = key
                        place[cell] = n_vertices
                        if n_vertices < keys.shape[1]:
                            keys[b, n_vertices] = key
                        n_vertices += 1
                    slots[n, r] = place[cell]
        sizes[b] = n_vertices


@helper
def _nearest(elevated, base, rest, rank, off):
    # The vertex with remainder 0 of every point's simplex is ``base`` times d + 1. It is the nearest point whose
    # coordinates are multiples of d + 1; if their sum is not 0, some coordinates are moved by one multiple. ``rest`` is
    # the residual in units of d + 1, ``rank`` its rank among the coordinates, ``off`` scratch.
    size = elevated.shape[0]
    part, max_rank = 1.0 / size, np.float64(size - 1)
    off[:] = 0.0
    for i in range(size):
        coordinate, whole, residual = elevated[i], base[i], rest[i]
        for p in range(off.size):
            whole[p] = np.floor(coordinate[p] * part + 0.5)
            residual[p] = coordinate[p] * part - whole[p]
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
        whole, residual, ranks = base[i], rest[i], rank[i]
        for p in range(off.size):
            r = ranks[p] + off[p]
            turn = (1.0 if r < 0.0 else 0.0) - (1.0 if r > max_rank else 0.0)
            ranks[p] = r + turn * (max_rank + 1.0)
            whole[p] += turn
            residual[p] -= turn


@jit
def _merge_vertices(keys, sizes, vertex, own, first_slot):
    # Write the vertex of every slot and the vertices' keys; return their hash table (keys, numbers) and their number.
    total = first_slot[-1]
    capacity = 1024
    while capacity < 2 * total:
        capacity *= 2
    table = empty(capacity, np.uint64)
    place = np.full(capacity, -1, np.int32)
    n_vertices = 0
    for b in range(sizes.size):
        for k in range(sizes[b]):
            at = _find(table, place, keys[b, k])
            if place[at] < 0:
                table[at] = keys[b, k]
                place[at] = n_vertices
                own[n_vertices] = keys[b, k]
                n_vertices += 1
            vertex[first_slot[b] + k] = place[at]
    return table, place, n_vertices


@jit
def _find_neighbors(begin, end, own, table, place, shifts, neighbors):
    # Write the two neighbors of every vertex along every axis; the number of vertices = none.
    axes, _, vertices = neighbors.shape
    steps, wrap = _steps(shifts)
    none = np.uint64(0)
    for v in range(begin, end):
        last = own[v] & np.uint64(15)
        up = wrap if last == np.uint64(axes - 1) else none
        down = wrap if last == none else none
        for axis in range(axes):
            for side in range(2):
                key = own[v] - steps[axis] - down if side else own[v] + steps[axis] + up
                at = _find(table, place, key)
                neighbors[axis, side, v] = place[at] if place[at] >= 0 else vertices


@jit
def _spread(begin, end, values, slots, weights, first_slot, band, partial):
    # Add (N, C) values, weighted, to the (T, C) slots of their simplices: ``partial``.
    count, corners = slots.shape
    for b in range(begin, end):
        partial[first_slot[b] : first_slot[b + 1]] = np.float32(0.0)
        for n in range(b * band, min(count, (b + 1) * band)):
            for c in range(corners):
                w, to = weights[n, c], slots[n, c]
                for k in range(values.shape[1]):
                    partial[to, k] += w * values[n, k]


@jit
def _read(begin, end, values, slots, vertex, weights, result):
    # Write to ``result`` (N, C) the weighted sums of the (V + 1, C) ``values`` at the vertices of every simplex.
    corners = slots.shape[1]
    for n in range(begin, end):
        for k in range(result.shape[1]):
            result[n, k] = np.float32(0.0)
        for c in range(corners):
            w, at = weights[n, c], vertex[slots[n, c]]
            for k in range(result.shape[1]):
                result[n, k] += w * values[at, k]


@jit
def _compute_own_share(begin, end, slots, vertex, weights, neighbors, factors, density, result):
    # Write to ``result`` the weight of every point's own value (see ``Lattice.own_share``).
    axes = factors.shape[0]
    for n in range(begin, end):
        total = np.float32(0.0)
        for i in range(axes):
            for j in range(axes):
                total += weights[n, i] * factors[i, j] * weights[n, j]
        if total > np.float32(0.05) * density[n]:
            total = np.float32(0.0)
            for i in range(axes):
                for j in range(axes):
                    for side in range(3):
                        reached = _response(slots[n], vertex, neighbors, i, j, side - 1)
                        total += weights[n, i] * reached * weights[n, j]
        result[n] = total


@helper
def _response(slots, vertex, neighbors, start, stop, turn):
    # Return the response of the blur at one vertex of a simplex to another vertex. The path takes one step along each
    # axis between the two, plus ``turn`` steps along every axis, which cancel.
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


@jit
def _gather_vertices(begin, end, partial, order, first, values, width):
    # Write to ``values`` the sum of the slots of every vertex; all are rows of ``width`` numbers.
    for v in range(begin, end):
        total = values[v * width : (v + 1) * width]
        total[:] = np.float32(0)
        for s in range(first[v], first[v + 1]):
            row = partial[order[s] * width : (order[s] + 1) * width]
            for k in range(width):
                total[k] += row[k]


@jit
def _blur_axis(begin, end, source, left, right, target, width):
    # Write to ``target`` the vertices' rows of ``width`` numbers, blurred by [1/2 1 1/2] along one axis.
    for v in range(begin, end):
        own, blurred = source[v * width : (v + 1) * width], target[v * width : (v + 1) * width]
        before = source[left[v] * width : (left[v] + 1) * width]
        after = source[right[v] * width : (right[v] + 1) * width]
        for k in range(width):
            blurred[k] = own[k] + np.float32(0.5) * (before[k] + after[k])
