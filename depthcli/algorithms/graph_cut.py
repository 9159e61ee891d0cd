"""Optimal assignment of two labels, false and true, by one minimum cut, on any graph or on the grid of pixels."""

from __future__ import annotations

from typing import Any

import maxflow
import numpy as np
from numpy.typing import NDArray


def binary_cut(
    cost_of_true: NDArray[np.float64], p: NDArray[np.int64], q: NDArray[np.int64], capacity: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return the labels x that minimize ``sum cost_of_true x + sum capacity (1 - x_p) x_q`` on a graph, (N,) bool.

    Parameters
    ----------
    cost_of_true : (N,) cost of the label true minus cost of false
    p, q : (E,) first and second node of every pair
    capacity : (E,) costs >= 0 of the pair (false, true)
    """
    graph: Any = maxflow.GraphFloat(len(cost_of_true), len(p))
    ids = graph.add_nodes(len(cost_of_true))
    # Source side is x = 0: a terminal edge that is cut belongs to the side the node is not on.
    graph.add_grid_tedges(ids, np.maximum(cost_of_true, 0.0), np.maximum(-cost_of_true, 0.0))
    if len(p):
        graph.add_edges(p, q, capacity, np.zeros_like(capacity))
    graph.maxflow()
    labels: NDArray[np.bool_] = graph.get_grid_segments(ids)
    return labels


STEPS = ((0, 1), (1, 0), (1, 1), (1, -1))
"""Offsets (row, column) of the four edges of each pixel; the other four of its eight neighbors are their reverses."""


def edge_ends(shape: tuple[int, int], step: tuple[int, int]) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Return two pairs of slices: of the pixels that have a neighbor at the offset ``step``, and of these neighbors."""
    height, width = shape
    dy, dx = step
    rows = slice(0, max(height - dy, 0)), slice(dy, height)
    if dx >= 0:
        columns = slice(0, max(width - dx, 0)), slice(dx, width)
    else:
        columns = slice(-dx, width), slice(0, max(width + dx, 0))
    return (rows[0], columns[0]), (rows[1], columns[1])


def grid_cut(
    gain_of_true: NDArray[np.floating[Any]], weights: tuple[NDArray[np.floating[Any]], ...]
) -> NDArray[np.bool_]:
    """Return the labels x that maximize ``sum gain_of_true x - sum weight |x_p - x_q|`` over pixels with 8 neighbors.

    Parameters
    ----------
    gain_of_true : (H, W), finite; what the label true gains over false at a pixel
    weights : one array for each of :data:`STEPS`: the weights >= 0 of its edges, of the shape of the first slices that
        :func:`edge_ends` returns

    Returns
    -------
    (H, W) bool

    Raises
    ------
    ValueError
        For other shapes, values that are not finite, or negative weights.
    """
    if gain_of_true.ndim != 2 or not np.isfinite(gain_of_true).all():
        raise ValueError(f"want finite gains (H, W), got {gain_of_true.shape}")
    if len(weights) != len(STEPS):
        raise ValueError(f"want weights for {len(STEPS)} steps, got {len(weights)}")
    shape = gain_of_true.shape[0], gain_of_true.shape[1]
    graph: Any = maxflow.GraphFloat(gain_of_true.size, len(STEPS) * gain_of_true.size)
    nodes = graph.add_grid_nodes(shape)
    for step, weight in zip(STEPS, weights, strict=True):
        start, end = edge_ends(shape, step)
        if weight.shape != nodes[start].shape or not (np.isfinite(weight).all() and (weight >= 0).all()):
            raise ValueError(f"want finite weights >= 0 of shape {nodes[start].shape}, got {weight.shape}")
        if weight.size:
            strength = np.ascontiguousarray(weight, np.float64).ravel()
            graph.add_edges(nodes[start].ravel(), nodes[end].ravel(), strength, strength)
    graph.add_grid_tedges(nodes, np.maximum(-gain_of_true, 0.0), np.maximum(gain_of_true, 0.0))
    graph.maxflow()
    labels: NDArray[np.bool_] = graph.get_grid_segments(nodes)
    return labels
