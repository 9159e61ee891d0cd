"""Regions of a label map: connected components, their pixels, their graph, and merging along it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from depthcli.core.maps import Doubles, Ints, Mask
from depthcli.kernels.jit import empty, helper, jit, run_bands, zeros

BAND = 32
"""Rows of an image per task; the result does not depend on it."""


@helper
def root(parent, i):
    """Return the root of i in a disjoint-set forest of (N,) ``parent`` indices, and shorten the path to it."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@helper
def join(parent, i, j):
    """Unite the sets of i and j. The smaller root remains, so that labels do not depend on the order of joining."""
    i, j = root(parent, i), root(parent, j)
    if i < j:
        parent[j] = i
    elif j < i:
        parent[i] = j


def _components(color: NDArray[Any], limit: float) -> Ints:
    # Join pixels inside bands of rows in parallel, then across the borders of the bands.
    parent = np.empty(color.shape[:2], np.int32)
    run_bands(_join_inside, -(-color.shape[0] // BAND), color, limit, parent.ravel())
    return np.asarray(_joined(color, limit, parent.ravel()).reshape(parent.shape), np.int32)


@jit
def _join_inside(begin, end, color, limit, parent):
    height, width, _ = color.shape
    for band in range(begin, end):
        for y in range(band * BAND, min(height, (band + 1) * BAND)):
            for x in range(width):
                p = y * width + x
                parent[p] = parent[p - 1] if x > 0 and _similar(color[y, x], color[y, x - 1], limit) else p
            if y > band * BAND:
                _join_rows(color, y, limit, parent)


@jit
def _joined(color, limit, parent):
    for y in range(BAND, color.shape[0], BAND):
        _join_rows(color, y, limit, parent)
    return consecutive(parent)


@helper
def _similar(color, other, limit):
    squared = np.int64(0)
    for c in range(color.size):
        difference = np.int64(color[c]) - np.int64(other[c])
        squared += difference * difference
    return squared <= limit


@helper
def _join_rows(color, y, limit, parent):
    width = color.shape[1]
    below = above = -1  # sets that were joined last
    for x in range(width):
        p = y * width + x
        if _similar(color[y, x], color[y - 1, x], limit) and (parent[p] != below or parent[p - width] != above):
            below, above = parent[p], parent[p - width]
            join(parent, below, above)


@jit
def consecutive(parent):
    """Return (N,) int32 labels of the sets, numbered in the order of their roots."""
    labels = empty(parent.size, np.int32)
    count = 0
    for i in range(parent.size):
        if parent[i] == i:  # parents come before their members
            labels[i] = count
            count += 1
        else:
            labels[i] = labels[parent[i]]
    return labels


class RegionPixels(NamedTuple):
    """The pixels of every region of a label map."""

    order: NDArray[np.int64]  # (P,) int64 flat pixel indices, region by region, raster order inside
    starts: NDArray[np.int64]  # (n + 1,) int64 start of each region in ``order``

    @classmethod
    def of(cls, labels: Ints, chosen: Mask | None = None, count: int | None = None) -> RegionPixels:
        """Return the pixels of an (H, W) label map by label: all pixels, or only the ``chosen`` ones, (H, W) bool."""
        count = int(labels.max()) + 1 if count is None else count
        chosen = np.ones(labels.shape, np.bool_) if chosen is None else chosen
        return cls(*_counting_sort(np.ascontiguousarray(labels).ravel(), np.ascontiguousarray(chosen).ravel(), count))

    def divided(self, chosen: Mask) -> tuple[RegionPixels, RegionPixels]:
        """Return the ``chosen`` pixels, (H, W) bool, and the others."""
        order, starts, other_order, other_starts = _divided(self.order, self.starts, chosen.ravel())
        return RegionPixels(order, starts), RegionPixels(other_order, other_starts)

    @property
    def sizes(self) -> NDArray[np.int64]:
        """Number of pixels of every region, (n,)."""
        return np.diff(self.starts)


@jit
def _divided(order, starts, chosen):
    first, second = empty(order.size + 1, np.int64), empty(order.size + 1, np.int64)
    first_starts = np.zeros_like(starts)
    count = 0
    for s in range(starts.size - 1):
        for k in range(starts[s], starts[s + 1]):
            first[count], second[k - count] = order[k], order[k]  # a branch would often be mispredicted
            count += chosen[order[k]]
        first_starts[s + 1] = count
    return first[:count].copy(), first_starts, second[: order.size - count].copy(), starts - first_starts


@jit
def _counting_sort(labels, chosen, count):
    starts = zeros(count + 1, np.int64)
    for p in range(labels.size):
        if chosen[p]:
            starts[labels[p] + 1] += 1
    for s in range(count):
        starts[s + 1] += starts[s]
    order = empty(starts[count], np.int64)
    free = starts[:count].copy()
    for p in range(labels.size):
        if chosen[p]:
            s = labels[p]
            order[free[s]] = p
            free[s] += 1
    return order, starts


def connected_components(color: NDArray[Any], max_distance: float) -> Ints:
    """Return labels of the connected regions of similar color in an (H, W, C) image of integers, at most int32.

    4-neighbors whose Euclidean color distance is at most ``max_distance`` belong to the same region. Labels count from
    0 in raster order of the regions' first pixels.
    """
    return _components(np.ascontiguousarray(color, np.int32), max_distance * max_distance)


def connected_components_of_labels(labels: Ints) -> Ints:
    """Return labels of the 4-connected pieces of equal value in an (H, W) int32 map, in raster order."""
    return _components(np.ascontiguousarray(labels)[..., None], 0.0)


@dataclass(frozen=True)
class RegionGraph:
    """The regions of a label map and their neighborhood."""

    sizes: NDArray[np.int64]  # (N,) int64 pixels of every region
    edges: Ints  # (E, 2) int32 pairs i < j of 4-neighboring regions, sorted
    boundary: NDArray[np.int64]  # (E,) int64 number of 4-neighbor pixel pairs along the common boundary
    sums: Doubles  # (N, C) float64 color sum of every region

    @property
    def means(self) -> Doubles:
        """Mean color of every region, (N, C) float64."""
        return self.sums / np.maximum(self.sizes, 1)[:, None]

    @property
    def distances(self) -> Doubles:
        """Squared distance between the mean colors of each edge's two regions, (E,) float64."""
        first, second = self.edges.T
        # By channels, since gathering and summing rows of three numbers is slow.
        channels = (np.ascontiguousarray(channel) for channel in self.means.T)
        return np.asarray(sum(np.square(channel[first] - channel[second]) for channel in channels), np.float64)


def region_sums(labels: Ints, image: NDArray[Any], count: int) -> tuple[NDArray[np.int64], Doubles]:
    """Return the number of pixels, (count,), and the sums of ``image`` (H, W[, C]), (count, C), of each region."""
    sizes, sums = _sums(labels.ravel(), image.reshape(labels.size, -1), count)
    return sizes, sums


def region_graph(labels: Ints, image: NDArray[Any]) -> RegionGraph:
    """Return the graph of the regions of ``labels`` (H, W), 0 .. n - 1, over ``image`` (H, W) or (H, W, C)."""
    count = int(labels.max()) + 1 if labels.size else 0
    sizes, sums = region_sums(labels, image, count)
    edges, boundary = _edges(*region_adjacency(labels, count))
    return RegionGraph(sizes, edges, boundary, sums)


@jit
def _sums(labels, colors, count):
    sizes, sums = zeros(count, np.int64), zeros((count, colors.shape[1]), np.float64)
    for p in range(labels.size):
        sizes[labels[p]] += 1
        for c in range(colors.shape[1]):
            sums[labels[p], c] += colors[p, c]
    return sizes, sums


@jit
def _edges(starts, neighbors, boundary):
    # Return the sorted (E, 2) edges i < j, each once, and their boundaries, from the result of region_adjacency.
    count = starts.size - 1
    free = zeros(count + 1, np.int64)
    for i in range(count):
        free[i + 1] = free[i]
        for k in range(starts[i], starts[i + 1]):
            free[i + 1] += neighbors[k] > i
    edges, lengths = empty((free[count], 2), np.int32), empty(free[count], np.int64)
    for j in range(count):
        for k in range(starts[j], starts[j + 1]):
            i = neighbors[k]
            if i < j:
                edges[free[i], 0], edges[free[i], 1], lengths[free[i]] = i, j, boundary[k]
                free[i] += 1
    return edges, lengths


def merge_small_regions(labels: Ints, image: NDArray[Any], min_size: int, by_boundary: bool = False) -> Ints:
    """Join every region of fewer than ``min_size`` pixels to the neighbor with the most similar mean color.

    Regions join in rounds until all are large enough, or no region has a neighbor to join. With ``by_boundary``, a
    region joins the neighbor of exactly the same color with the longest common boundary instead, if there is one.
    Labels are (H, W) int32, from 0 on.
    """
    count = int(labels.max()) + 1
    sizes, sums = region_sums(labels, image, count)
    means = sums / np.maximum(sizes, 1)[:, None]
    starts, neighbors, boundary = region_adjacency(labels, count)
    # The first member represents a merged region; the other members follow in a linked list.
    parent, following = np.arange(count, dtype=np.int32), np.full(count, -1, np.int32)
    last = parent.copy()
    small = np.flatnonzero(sizes < min_size)
    while True:
        target = np.empty(len(small), np.int32)
        run_bands(
            _find_targets, BAND, small, means, parent, following, starts, neighbors, boundary, by_boundary, target
        )
        if not (target >= 0).any():
            number: Ints = consecutive(parent)
            return number[labels]
        small = _join_targets(small, target, sizes, sums, means, parent, following, last, min_size)


@jit
def _find_targets(begin, end, small, means, parent, following, starts, neighbors, boundary, by_boundary, target):
    # Write the neighbors that the ``small`` regions join, -1 = none.
    for task in range(begin, end):
        lengths = zeros(parent.size if by_boundary else 0, np.int64)
        for k in range(small.size * task // BAND, small.size * (task + 1) // BAND):
            graph = parent, following, starts, neighbors, boundary
            target[k] = _best_neighbor(small[k], means, *graph, lengths, by_boundary)


@helper
def _best_neighbor(region, means, parent, following, starts, neighbors, boundary, lengths, by_boundary):
    # Return the neighbor with the most similar mean color or, ``by_boundary``, the neighbor of the same color with the
    # longest common boundary; the first of equal ones, -1 if there is none. ``lengths`` are zeros before and after.
    best, min_rank = np.int32(-1), np.inf
    for turn in range(2):
        member = region if turn or by_boundary else -1
        while member >= 0:
            for k in range(starts[member], starts[member + 1]):
                m = parent[neighbors[k]]
                if turn == 0:
                    lengths[m] += boundary[k]
                    continue
                rank, limit = 0.0, 0.0 if by_boundary else min_rank
                for c in range(means.shape[1]):
                    square = (means[region, c] - means[m, c]) ** 2
                    rank += square
                    if square > limit:
                        break
                if by_boundary:  # lengths are complete now; 0 for further parts of the same boundary
                    rank = -np.float64(lengths[m]) if rank == 0.0 else np.inf
                    lengths[m] = 0
                if m != region and (rank < min_rank or (rank == min_rank and m < best)):
                    best, min_rank = m, rank
            member = following[member]
    return best


@jit
def _join_targets(small, target, sizes, sums, means, parent, following, last, min_size):
    # Join the regions ``small`` to their targets; return those that are still small.
    for k in range(small.size):
        if target[k] < 0:
            continue
        first, other = root(parent, np.int32(small[k])), root(parent, target[k])
        if first != other:
            first, other = min(first, other), max(first, other)
            parent[other] = first
            following[last[first]], last[first] = other, last[other]
            sizes[first] += sizes[other]
            for c in range(sums.shape[1]):
                sums[first, c] += sums[other, c]
    for r in range(parent.size):
        parent[r] = parent[parent[r]]
    left = np.empty_like(small)
    count = 0
    for k in range(small.size):
        first = parent[small[k]]
        if target[k] >= 0:
            for c in range(sums.shape[1]):
                means[first, c] = sums[first, c] / sizes[first]
        left[count] = first
        count += (first == small[k]) & (sizes[first] < min_size)
    return left[:count].copy()


@jit
def joined_regions(count, edges):
    """Return the group of each region, (count,) int32, after ``edges`` (E, 2) have joined regions.

    Groups are numbered in the order of their first members.
    """
    parent = np.arange(count).astype(np.int32)
    for e in range(len(edges)):
        join(parent, edges[e, 0], edges[e, 1])
    return consecutive(parent)


@jit
def region_adjacency(labels, count):
    """Return the neighbors of the regions 0 .. count - 1 of a label map (H, W), ordered by region.

    The results are ``starts`` (count + 1,), the neighbors, and the lengths (int64) of the common boundaries. Elements
    ``starts[s] .. starts[s + 1] - 1`` belong to region s; its neighbors are in the raster order in which its boundary
    first touches them. A length is the number of 4-neighboring pairs of pixels.
    """
    # Branches would often be mispredicted: every pair is written, and counted only if it remains.
    height, width = labels.shape
    pairs = empty((2 * labels.size + 1, 2), np.int32)
    n_pairs = 0
    for y in range(height):
        row, below = labels[y], labels[min(y + 1, height - 1)]
        for x in range(width):
            for other in (row[min(x + 1, width - 1)], below[x]):
                pairs[n_pairs, 0], pairs[n_pairs, 1] = row[x], other
                n_pairs += row[x] != other
    starts = zeros(count + 1, np.int64)
    for k in range(n_pairs):
        starts[pairs[k, 0] + 1] += 1
        starts[pairs[k, 1] + 1] += 1
    for s in range(count):
        starts[s + 1] += starts[s]
    neighbors = empty(starts[count], np.int32)
    free = starts[:count].copy()
    for k in range(n_pairs):
        s, t = pairs[k]
        neighbors[free[s]], neighbors[free[t]] = t, s
        free[s] += 1
        free[t] += 1
    # Remove repetitions from each bucket in place.
    place, boundary = np.full(count, -1, np.int64), zeros(neighbors.size, np.int64)
    end = 0
    for s in range(count):
        first, last = starts[s], starts[s + 1]
        starts[s] = end
        for k in range(first, last):
            t = neighbors[k]
            is_new = place[t] < starts[s]
            place[t] = end if is_new else place[t]
            neighbors[end] = t
            boundary[place[t]] += 1
            end += is_new
    starts[count] = end
    return starts, neighbors[:end], boundary[:end]
