"""Optimal assignment of two labels by one minimum cut, on any graph or on the grid of pixels."""

from __future__ import annotations

from typing import Any

import maxflow
import numpy as np
from numpy.typing import NDArray


def binary_cut(
    score: NDArray[np.float64], p: NDArray[np.int64], q: NDArray[np.int64], capacity: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return the labels x that minimize ``sum score x + sum capacity (1 - x_p) x_q`` on a graph.

    Parameters
    ----------
    score : (N,) cost of true minus cost of false
    p, q : (E,) nodes of every pair
    capacity : (E,) costs >= 0
    """
    graph: Any = maxflow.GraphFloat(len(score), len(p))
    ids = graph.add_nodes(len(score))
    # Source side is x = 0: a terminal edge that is cut belongs to the side the node is not on.
    graph.add_grid_tedges(ids, np.maximum(score, 0.0), np.maximum(-score, 0.0))
    if len(p):
        graph.add_edges(p, q, capacity, np.zeros_like(capacity))
    graph.maxflow()
    labels: NDArray[np.bool_] = graph.get_grid_segments(ids)
    return labels


STEPS = ((0, 1), (1, 0), (1, 1), (1, -1))
"""Row and column steps from a pixel to the four of its eight neighbors that its edges lead to."""


def edge_ends(shape: tuple[int, int], step: tuple[int, int]) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Return slices of the pixels that have a neighbor one ``step`` away, and of those neighbors."""
    height, width = shape
    dy, dx = step
    rows = slice(0, max(height - dy, 0)), slice(dy, height)
    if dx >= 0:
        columns = slice(0, max(width - dx, 0)), slice(dx, width)
    else:
        columns = slice(-dx, width), slice(0, max(width + dx, 0))
    return (rows[0], columns[0]), (rows[1], columns[1])


def grid_cut(score: NDArray[np.floating[Any]], weights: tuple[NDArray[np.floating[Any]], ...]) -> NDArray[np.bool_]:
    """Return the labels x that maximize ``sum score x - sum weight |x_p - x_q|`` over pixels and their eight neighbors.

    Parameters
    ----------
    score : (H, W) finite value of the label true at a pixel
    weights : for every one of :data:`STEPS` the weights >= 0 of its edges, of the shape that ``edge_ends`` cuts out

    Returns
    -------
    (H, W) bool

    Raises
    ------
    ValueError
        For other shapes, values that are not finite, or negative weights.
    """
    if score.ndim != 2 or not np.isfinite(score).all():
        raise ValueError(f"want finite scores (H, W), got {score.shape}")
    if len(weights) != len(STEPS):
        raise ValueError(f"want weights for {len(STEPS)} steps, got {len(weights)}")
    shape = score.shape[0], score.shape[1]
    graph: Any = maxflow.GraphFloat(score.size, len(STEPS) * score.size)
    nodes = graph.add_grid_nodes(shape)
    for step, weight in zip(STEPS, weights, strict=True):
        start, end = edge_ends(shape, step)
        if weight.shape != nodes[start].shape or not (np.isfinite(weight).all() and (weight >= 0).all()):
            raise ValueError(f"want finite weights >= 0 of shape {nodes[start].shape}, got {weight.shape}")
        if weight.size:
            strength = np.ascontiguousarray(weight, np.float64).ravel()
            graph.add_edges(nodes[start].ravel(), nodes[end].ravel(), strength, strength)
    graph.add_grid_tedges(nodes, np.maximum(-score, 0.0), np.maximum(score, 0.0))
    graph.maxflow()
    labels: NDArray[np.bool_] = graph.get_grid_segments(nodes)
    return labels
