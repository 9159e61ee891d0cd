"""Lists of neighbors of the nodes of a graph, and of the regions of a label map."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.kernels.jit import jit


def adjacency(
    count: int, edges: NDArray[np.int32], weights: NDArray[Any]
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[Any]]:
    """Return the neighbors of the nodes 0 .. count - 1 of an undirected graph, ordered by node.

    Parameters
    ----------
    edges : (E, 2) int32, each edge once
    weights : (E,) a number for each edge, such as its cost or the length of a common boundary

    Returns
    -------
    starts : (count + 1,) int64; the elements ``starts[n] .. starts[n + 1] - 1`` of the other arrays belong to node n
    neighbors : (2 E,) int32
    weights : (2 E,) of the edges to these neighbors
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
