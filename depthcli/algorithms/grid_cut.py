"""Two labels on a grid, by one minimum cut."""

from __future__ import annotations

from typing import Any

import maxflow
import numpy as np
from numpy.typing import NDArray

STEPS = ((0, 1), (1, 0), (1, 1), (1, -1))
"""Row and column steps to the four neighbors that edges lead to; the other four lead back."""


def edge_ends(shape: tuple[int, int], step: tuple[int, int]) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Slices of the pixels that have a neighbor one ``step`` away, and of those neighbors."""
    height, width = shape
    down, across = step
    rows = slice(0, max(height - down, 0)), slice(down, height)
    if across >= 0:
        columns = slice(0, max(width - across, 0)), slice(across, width)
    else:
        columns = slice(-across, width), slice(0, max(width + across, 0))
    return (rows[0], columns[0]), (rows[1], columns[1])


def grid_cut(score: NDArray[np.floating[Any]], weights: tuple[NDArray[np.floating[Any]], ...]) -> NDArray[np.bool_]:
    """The labels x that maximize ``sum score x - sum weight |x_p - x_q|`` over pixels and their eight neighbors.

    Parameters
    ----------
    score : (H, W) finite; what the label true is worth at a pixel
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
        here, there = edge_ends(shape, step)
        if weight.shape != nodes[here].shape or not (np.isfinite(weight).all() and (weight >= 0).all()):
            raise ValueError(f"want finite weights >= 0 of shape {nodes[here].shape}, got {weight.shape}")
        if weight.size:
            strength = np.ascontiguousarray(weight, np.float64).ravel()
            graph.add_edges(nodes[here].ravel(), nodes[there].ravel(), strength, strength)
    graph.add_grid_tedges(nodes, np.maximum(-score, 0.0), np.maximum(score, 0.0))
    graph.maxflow()
    found: NDArray[np.bool_] = graph.get_grid_segments(nodes)
    return found
