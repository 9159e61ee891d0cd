"""Regions of a label map: connected components, their pixels, their graph, and merging along it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from depthcli.kernels.jit import jit, parallel_jit, prange

BAND = 32
"""Rows of an image that one thread joins; the result does not depend on it."""


@jit
def root(parent, i):
    """Return the root of the set of i in a disjoint-set forest, given as (N,) parents, whose paths are shortened."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@jit
def join(parent, i, j):
    """Unite the sets of i and j; the smaller root stays, so that labels do not depend on the order of joining."""
    i, j = root(parent, i), root(parent, j)
    if i < j:
        parent[j] = i
    elif j < i:
        parent[i] = j


@parallel_jit
def _components(color, limit):
    # Pixels are joined inside of bands of rows, side by side, then across the rims of the bands.
    height, width, _ = color.shape
    parent = np.empty(height * width, np.int32)
    for band in prange(-(-height // BAND)):
        for y in range(band * BAND, min(height, (band + 1) * BAND)):
            for x in range(width):
                p = y * width + x
                parent[p] = parent[p - 1] if x > 0 and _similar(color[y, x], color[y, x - 1], limit) else p
            if y > band * BAND:
                _join_rows(color, y, limit, parent)
    for y in range(BAND, height, BAND):
        _join_rows(color, y, limit, parent)
    return consecutive(parent).reshape(height, width)


@jit
def _similar(color, other, limit):
    squared = np.int64(0)
    for c in range(color.size):
        difference = np.int64(color[c]) - np.int64(other[c])
        squared += difference * difference
    return squared <= limit


@jit
def _join_rows(color, y, limit, parent):
    width = color.shape[1]
    below = above = -1  # what was joined last
    for x in range(width):
        p = y * width + x
        if _similar(color[y, x], color[y - 1, x], limit) and (parent[p] != below or parent[p - width] != above):
            below, above = parent[p], parent[p - width]
            join(parent, below, above)


@jit
def consecutive(parent):
    """Return (N,) int32 numbers of the sets, counted in the order of their roots."""
    labels = np.empty(parent.size, np.int32)
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
    starts: NDArray[np.int64]  # (n + 1,) int64 where each region begins in ``order``

    @classmethod
    def of(
        cls, labels: NDArray[np.int32], chosen: NDArray[np.bool_] | None = None, count: int | None = None
    ) -> RegionPixels:
        """Return the pixels of an (H, W) label map by label, all of them or only the ``chosen`` ones, (H, W) bool."""
        count = int(labels.max()) + 1 if count is None else count
        chosen = np.ones(labels.shape, np.bool_) if chosen is None else chosen
        return cls(*_counting_sort(np.ascontiguousarray(labels).ravel(), np.ascontiguousarray(chosen).ravel(), count))

    @property
    def sizes(self) -> NDArray[np.int64]:
        """Number of pixels of every region, (n,)."""
        return np.diff(self.starts)


@jit
def _counting_sort(labels, chosen, count):
    starts = np.zeros(count + 1, np.int64)
    for p in range(labels.size):
        if chosen[p]:
            starts[labels[p] + 1] += 1
    for s in range(count):
        starts[s + 1] += starts[s]
    order = np.empty(starts[count], np.int64)
    free = starts[:count].copy()
    for p in range(labels.size):
        if chosen[p]:
            s = labels[p]
            order[free[s]] = p
            free[s] += 1
    return order, starts


@jit
def _best_neighbors(edges, rank, selected):
    # The (N,) int32 neighbors of smallest rank of the selected regions, the first of equal ones; -1 where none.
    best = np.full(selected.size, -1, np.int32)
    min_rank = np.empty(selected.size, np.float64)
    for e in range(edges.shape[0]):
        for side in range(2):
            n, m = edges[e, side], edges[e, 1 - side]
            if selected[n] and (best[n] < 0 or rank[e] < min_rank[n] or (rank[e] == min_rank[n] and m < best[n])):
                best[n] = m
                min_rank[n] = rank[e]
    return best


def connected_components(color: NDArray[Any], max_distance: float) -> NDArray[np.int32]:
    """Return the labels of regions of an (H, W, C) image of integers in which neighbors have similar colors.

    4-neighbors whose Euclidean color distance is at most ``max_distance`` belong to the same region. Labels count from
    0 in raster order of the regions' first pixels.
    """
    return np.asarray(_components(np.ascontiguousarray(color), max_distance * max_distance), np.int32)


def connected_components_of_labels(labels: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return labels of the 4-connected pieces of equal value in an (H, W) int32 map; numbered in the same order."""
    return np.asarray(_components(np.ascontiguousarray(labels)[..., None], 0.0), np.int32)


@dataclass(frozen=True)
class RegionGraph:
    """The regions of a label map and their neighborhood."""

    sizes: NDArray[np.int64]  # (N,) int64 pixels of every region
    edges: NDArray[np.int32]  # (E, 2) int32 pairs i < j of 4-neighboring regions, sorted
    boundary: NDArray[np.int64]  # (E,) int64 number of 4-neighbor pixel pairs along the common boundary
    sums: NDArray[np.float64]  # (N, C) float64 sum of the colors of every region

    @property
    def means(self) -> NDArray[np.float64]:
        """Mean color of every region, (N, C) float64."""
        return self.sums / np.maximum(self.sizes, 1)[:, None]

    @property
    def distances(self) -> NDArray[np.float64]:
        """Squared distance of the mean colors of the two regions of every edge, (E,) float64."""
        first, second = self.edges.T
        # By channels: gathering rows of three numbers, and sums over so few, are slow.
        channels = (np.ascontiguousarray(channel) for channel in self.means.T)
        return np.asarray(sum(np.square(channel[first] - channel[second]) for channel in channels), np.float64)


def region_graph(labels: NDArray[np.int32], image: NDArray[Any]) -> RegionGraph:
    """Return the graph of the regions of ``labels`` (H, W), 0 .. n - 1, over ``image`` (H, W) or (H, W, C)."""
    count = int(labels.max()) + 1 if labels.size else 0
    sizes, sums = _sums(labels.ravel(), image.reshape(labels.size, -1), count)
    ends = _neighbors(labels)
    edges, boundary = _distinct_edges(ends, np.ones(len(ends), np.int64), count)
    return RegionGraph(sizes, edges, boundary, sums)


@jit
def _sums(labels, colors, count):
    sizes, sums = np.zeros(count, np.int64), np.zeros((count, colors.shape[1]))
    for p in range(labels.size):
        sizes[labels[p]] += 1
        for c in range(colors.shape[1]):
            sums[labels[p], c] += colors[p, c]
    return sizes, sums


@jit
def _neighbors(labels):
    # The (M, 2) labels of all 4-neighboring pixels of two regions.
    height, width = labels.shape
    ends = np.empty((2 * labels.size, 2), np.int32)
    count = 0
    for y in range(height):
        for x in range(width):
            for y2, x2 in ((y, x + 1), (y + 1, x)):
                if y2 < height and x2 < width and labels[y2, x2] != labels[y, x]:
                    ends[count, 0], ends[count, 1] = labels[y, x], labels[y2, x2]
                    count += 1
    return ends[:count].copy()


@jit
def _distinct_edges(ends, weights, count):
    # The sorted (E, 2) edges i < j between regions 0 .. count - 1, each once, and the sums of their weights.
    order = np.flatnonzero(ends[:, 0] != ends[:, 1])
    for turn in range(2):  # sorted by the larger end, then by the smaller one
        key = np.empty(order.size, np.int32)
        starts = np.zeros(count + 1, np.int64)
        for k in range(order.size):
            a, b = ends[order[k], 0], ends[order[k], 1]
            key[k] = max(a, b) if turn == 0 else min(a, b)
            starts[key[k] + 1] += 1
        for s in range(count):
            starts[s + 1] += starts[s]
        before, order = order, np.empty_like(order)
        for k in range(order.size):
            order[starts[key[k]]] = before[k]
            starts[key[k]] += 1
    edges, sums = np.empty((order.size, 2), np.int32), np.zeros(order.size, np.int64)
    n = -1
    for e in order:
        a, b = min(ends[e, 0], ends[e, 1]), max(ends[e, 0], ends[e, 1])
        if n < 0 or edges[n, 0] != a or edges[n, 1] != b:
            n += 1
            edges[n, 0], edges[n, 1] = a, b
        sums[n] += weights[e]
    return edges[: n + 1].copy(), sums[: n + 1].copy()


def _merged(graph: RegionGraph, source: NDArray[Any], target: NDArray[Any]) -> tuple[RegionGraph, NDArray[np.int32]]:
    # The graph after the regions ``source`` have joined ``target``, and the new number of every region.
    group = joined_regions(len(graph.sizes), np.stack([source, target], axis=1).astype(np.int32))
    count = int(group.max()) + 1
    sizes = np.bincount(group, graph.sizes, count).astype(np.int64)
    sums = np.stack([np.bincount(group, column, count) for column in graph.sums.T], axis=1).astype(np.float64)
    edges, boundary = _distinct_edges(group[graph.edges], graph.boundary, count)
    return RegionGraph(sizes, edges, boundary, sums), group


def merge_small_regions(
    labels: NDArray[np.int32], image: NDArray[Any], min_size: int, by_boundary: bool = False
) -> NDArray[np.int32]:
    """Join every region of fewer than ``min_size`` pixels to the neighbor with the most similar mean color.

    Regions join in rounds until all are large enough (or only one is left). ``by_boundary``: they join the neighbor of
    the same color with the longest common boundary instead, if there is one. Labels are (H, W) int32 from 0 on.
    """
    graph = region_graph(labels, image)
    number = np.arange(len(graph.sizes), dtype=np.int32)
    while True:
        distance = graph.distances
        edges, rank = graph.edges, distance
        if by_boundary:
            edges, rank = edges[distance == 0], -graph.boundary[distance == 0].astype(np.float64)
        target = _best_neighbors(edges, rank, graph.sizes < min_size)
        source = np.flatnonzero(target >= 0)
        if len(source) == 0:
            return number[labels]
        graph, group = _merged(graph, source, target[source])
        number = group[number]


@jit
def joined_regions(count, edges):
    """Return the (count,) int32 groups of regions joined by ``edges`` (E, 2), numbered by their first members."""
    parent = np.arange(count).astype(np.int32)
    for e in range(len(edges)):
        join(parent, edges[e, 0], edges[e, 1])
    return consecutive(parent)


def adjacency(
    count: int, edges: NDArray[np.int32], weights: NDArray[Any]
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[Any]]:
    """Return the neighbors of the nodes 0 .. count - 1 of an undirected graph, ordered by node.

    Given are edges (E, 2), each once, and a weight for each. Returned are (count + 1,) ``starts``, (2 E,) neighbors and
    the weights of the edges to them, whose elements ``starts[n] .. starts[n + 1] - 1`` belong to node n.
    """
    source = edges.T.ravel()
    order = np.argsort(source, kind="stable")
    starts = np.concatenate([[0], np.cumsum(np.bincount(source, minlength=count))]).astype(np.int64)
    return starts, edges[:, ::-1].T.ravel()[order], np.tile(weights, 2)[order]


@jit
def region_adjacency(labels, count):
    """Return the neighbors of the regions 0 .. count - 1 of a label map (H, W), in the form of :func:`adjacency`.

    The weights (int64) are lengths of common boundaries: numbers of 4-neighboring pairs of pixels. The neighbors of a
    region are in the raster order in which its boundary first touches them.
    """
    height, width = labels.shape
    starts = np.zeros(count + 1, np.int64)
    for y in range(height):
        for x in range(width):
            s = labels[y, x]
            for step in range(2):
                y2, x2 = (y, x + 1) if step == 0 else (y + 1, x)
                if y2 < height and x2 < width and labels[y2, x2] != s:
                    starts[s + 1] += 1
                    starts[labels[y2, x2] + 1] += 1
    for s in range(count):
        starts[s + 1] += starts[s]
    raw = np.empty(starts[count], np.int32)
    free = starts[:count].copy()
    for y in range(height):
        for x in range(width):
            s = labels[y, x]
            for step in range(2):
                y2, x2 = (y, x + 1) if step == 0 else (y + 1, x)
                if y2 < height and x2 < width and labels[y2, x2] != s:
                    t = labels[y2, x2]
                    raw[free[s]] = t
                    free[s] += 1
                    raw[free[t]] = s
                    free[t] += 1
    # Each bucket, written over itself without repetitions.
    place = np.full(count, -1, np.int64)
    boundary = np.zeros(raw.size, np.int64)
    end = 0
    for s in range(count):
        first, last = starts[s], starts[s + 1]
        starts[s] = end
        for k in range(first, last):
            t = raw[k]
            if place[t] < starts[s]:
                place[t] = end
                raw[end] = t
                boundary[end] = 0
                end += 1
            boundary[place[t]] += 1
    starts[count] = end
    return starts, raw[:end], boundary[:end]
