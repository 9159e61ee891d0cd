"""Label maps as graphs of regions: connected components, merging, adjacency."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.kernels.jit import jit


@jit
def root(parent, i):  # type: ignore[no-untyped-def]
    """First member of the set that i belongs to, in a forest of (N,) parents; shortens the way."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@jit
def join(parent, i, j):  # type: ignore[no-untyped-def]
    """Unite two sets. The smaller index becomes the root, so labels do not depend on the order of joining."""
    i, j = root(parent, i), root(parent, j)
    if i < j:
        parent[j] = i
    elif j < i:
        parent[i] = j


@jit
def _components(color, limit):  # type: ignore[no-untyped-def]
    height, width, channels = color.shape
    parent = np.arange(height * width).astype(np.int32)
    for y in range(height):
        for x in range(width):
            here = y * width + x
            for step in range(2):
                y2, x2 = (y, x - 1) if step == 0 else (y - 1, x)
                if y2 < 0 or x2 < 0:
                    continue
                apart = np.int64(0)
                for c in range(channels):
                    difference = np.int64(color[y, x, c]) - np.int64(color[y2, x2, c])
                    apart += difference * difference
                if apart <= limit:
                    join(parent, here, y2 * width + x2)
    return consecutive(parent).reshape(height, width)


@jit
def consecutive(parent):  # type: ignore[no-untyped-def]
    """(N,) int32 numbers of the sets, counted in the order of their roots."""
    labels = np.empty(parent.size, np.int32)
    count = 0
    for i in range(parent.size):
        first = root(parent, i)
        if first == i:  # roots come before their members
            labels[i] = count
            count += 1
        else:
            labels[i] = labels[first]
    return labels


@jit
def _join_all(parent, first, second):  # type: ignore[no-untyped-def]
    for i in range(first.size):
        join(parent, first[i], second[i])


def connected_components(color: NDArray[np.uint8], max_distance: float) -> NDArray[np.int32]:
    """Label 4-connected pixels of an (H, W, C) image whose Euclidean color distance is <= ``max_distance``.

    Labels (H, W) int32 count from 0 in raster order of the regions' first pixels.
    """
    labels: NDArray[np.int32] = _components(np.ascontiguousarray(color), max_distance * max_distance)
    return labels


def connected_components_of_labels(labels: NDArray[np.int32]) -> NDArray[np.int32]:
    """4-connected pieces of equal value in an (H, W) int32 map, numbered like :func:`connected_components`."""
    pieces: NDArray[np.int32] = _components(np.ascontiguousarray(labels)[..., None], 0.0)
    return pieces


@dataclass(frozen=True)
class RegionGraph:
    """Regions of a label map and who touches whom.

    Attributes
    ----------
    sizes : (N,) int64 pixels of every region
    means : (N, C) float64 mean color of every region
    edges : (E, 2) int32 pairs i < j of 4-neighboring regions, sorted
    boundary : (E,) int64 number of 4-neighbor pixel pairs along the common boundary
    """

    sizes: NDArray[np.int64]
    means: NDArray[np.float64]
    edges: NDArray[np.int32]
    boundary: NDArray[np.int64]


def region_graph(labels: NDArray[np.int32], image: NDArray[Any]) -> RegionGraph:
    """Graph of the regions of ``labels`` (H, W), 0 .. n - 1, over ``image`` (H, W) or (H, W, C)."""
    count = int(labels.max()) + 1 if labels.size else 0
    flat = labels.ravel()
    sizes = np.bincount(flat, minlength=count)
    channels = image.reshape(flat.size, -1)
    sums = np.stack([np.bincount(flat, channels[:, c], count) for c in range(channels.shape[1])], axis=1)
    means = sums.astype(np.float64) / np.maximum(sizes, 1)[:, None]
    pairs = []
    for one, other in ((labels[:, :-1], labels[:, 1:]), (labels[:-1], labels[1:])):
        touching = one != other
        low, high = np.minimum(one, other)[touching], np.maximum(one, other)[touching]
        pairs.append(low.astype(np.int64) * count + high)
    keys, boundary = np.unique(np.concatenate(pairs), return_counts=True)
    edges = np.stack([keys // max(count, 1), keys % max(count, 1)], axis=1).astype(np.int32)
    return RegionGraph(sizes, means, edges, boundary)


def merge_small_regions(labels: NDArray[np.int32], image: NDArray[np.uint8], min_size: int) -> NDArray[np.int32]:
    """Join every region of fewer than ``min_size`` pixels to its neighbor of the nearest mean color.

    Regions join in rounds until all are large enough (or only one is left). Labels as in
    :func:`connected_components`.
    """
    while True:
        graph = region_graph(labels, image)
        small = graph.sizes < min_size
        if len(graph.sizes) < 2 or not small.any():
            return labels
        first, second = graph.edges.T
        apart = np.square(graph.means[first] - graph.means[second]).sum(axis=1)
        source = np.concatenate([first, second])
        target = np.concatenate([second, first])
        distance = np.concatenate([apart, apart])
        wanted = small[source]
        source, target, distance = source[wanted], target[wanted], distance[wanted]
        order = np.lexsort((target, distance, source))
        source, nearest = np.unique(source[order], return_index=True)
        parent = np.arange(len(graph.sizes), dtype=np.int32)
        _join_all(parent, source.astype(np.int32), target[order][nearest].astype(np.int32))
        labels = consecutive(parent)[labels]


def joined_regions(count: int, edges: NDArray[np.int32]) -> NDArray[np.int32]:
    """(count,) int32 group of every region, numbered by first member, where ``edges`` (E, 2) join regions."""
    parent = np.arange(count, dtype=np.int32)
    _join_all(parent, np.ascontiguousarray(edges[:, 0]), np.ascontiguousarray(edges[:, 1]))
    groups: NDArray[np.int32] = consecutive(parent)
    return groups


def merge_small_labels(pieces: NDArray[np.int32], parents: NDArray[np.int32], min_size: int) -> NDArray[np.int32]:
    """Join pieces of fewer than ``min_size`` pixels to the piece of the same parent they share most boundary with.

    ``parents`` (H, W) is the map the pieces (H, W) were cut from; a piece that is all of its parent stays.
    """
    while True:
        graph = region_graph(pieces, parents[..., None].astype(np.float64))
        first, second = graph.edges.T
        inside = graph.means[first, 0] == graph.means[second, 0]
        first, second, boundary = first[inside], second[inside], graph.boundary[inside]
        source, target = np.concatenate([first, second]), np.concatenate([second, first])
        longest = np.concatenate([boundary, boundary])
        wanted = graph.sizes[source] < min_size
        if not wanted.any():
            return pieces
        source, target, longest = source[wanted], target[wanted], longest[wanted]
        order = np.lexsort((target, -longest, source))
        source, best = np.unique(source[order], return_index=True)
        parent = np.arange(len(graph.sizes), dtype=np.int32)
        _join_all(parent, source.astype(np.int32), target[order][best].astype(np.int32))
        pieces = consecutive(parent)[pieces]
