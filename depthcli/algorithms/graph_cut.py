"""Optimal assignment of two labels, false and true, by one minimum cut, on any graph or on the grid of pixels."""

from __future__ import annotations

from typing import Any

import maxflow
import numpy as np
from numpy.typing import ArrayLike, NDArray

from depthcli.algorithms.regions import adjacency
from depthcli.kernels.jit import jit


def binary_cut(
    cost_of_true: NDArray[np.float64], p: NDArray[np.int64], q: NDArray[np.int64], capacity: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return the labels x that minimize ``sum cost_of_true x + sum capacity (1 - x_p) x_q`` on a graph, (N,) bool.

    ``cost_of_true`` (N,) is above that of false; the (E,) pairs of nodes (p, q) have costs ``capacity`` >= 0.
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
    (height, width), (dy, dx) = shape, step
    left, right = slice(max(-dx, 0), max(width - max(dx, 0), 0)), slice(max(dx, 0), max(width + min(dx, 0), 0))
    return (slice(0, max(height - dy, 0)), left), (slice(dy, height), right)


def grid_cut(
    gain_of_true: NDArray[np.floating[Any]], weights: tuple[NDArray[np.floating[Any]], ...]
) -> NDArray[np.bool_]:
    """Return the labels x that maximize ``sum gain_of_true x - sum weight |x_p - x_q|`` over pixels with 8 neighbors.

    ``gain_of_true`` and the labels are (H, W). There is one array of weights >= 0 for each of :data:`STEPS`, of the
    shape of the first slices that :func:`edge_ends` returns.
    """
    shape = gain_of_true.shape[0], gain_of_true.shape[1]
    graph: Any = maxflow.GraphFloat(gain_of_true.size, len(STEPS) * gain_of_true.size)
    nodes = graph.add_grid_nodes(shape)
    for step, weight in zip(STEPS, weights, strict=True):
        start, end = edge_ends(shape, step)
        if weight.size:
            strength = np.ascontiguousarray(weight, np.float64).ravel()
            graph.add_edges(nodes[start].ravel(), nodes[end].ravel(), strength, strength)
    graph.add_grid_tedges(nodes, np.maximum(-gain_of_true, 0.0), np.maximum(gain_of_true, 0.0))
    graph.maxflow()
    labels: NDArray[np.bool_] = graph.get_grid_segments(nodes)
    return labels


def potts_energy(labels: ArrayLike, unary: ArrayLike, edges: ArrayLike, weights: ArrayLike) -> float:
    """Return the sum of ``unary[n, labels[n]]`` and of the weights of all edges whose ends differ in label."""
    labels = np.asarray(labels)
    ends = np.asarray(edges, dtype=np.int64).reshape(-1, 2)
    data = np.asarray(unary)[np.arange(labels.size), labels].sum()
    return float(data + np.asarray(weights)[labels[ends[:, 0]] != labels[ends[:, 1]]].sum())


def alpha_expansion(
    unary: ArrayLike, edges: ArrayLike, weights: ArrayLike, initial: ArrayLike | None = None, max_sweeps: int = 20
) -> tuple[NDArray[np.int32], float]:
    """Return (N,) labels of small Potts energy on a graph, and the energy (Boykov, Veksler and Zabih, PAMI 2001).

    Parameters
    ----------
    unary : (N, L) finite costs of every label at every node
    edges : (E, 2) node indices, each edge once, no loops; E may be 0
    weights : (E,) costs >= 0 of an edge whose ends have different labels
    initial : (N,) labels to start from, whose energy is never exceeded; default: the cheapest label of every node
    max_sweeps : largest number of passes over all labels; ends earlier when no move lowers the energy
    """
    costs = np.ascontiguousarray(unary, dtype=np.float64)
    ends = np.ascontiguousarray(edges, dtype=np.int32).reshape(-1, 2)
    strength = np.ascontiguousarray(weights, dtype=np.float64)
    nodes, label_count = costs.shape
    labels = np.argmin(costs, axis=1) if initial is None else np.array(initial)
    labels = labels.astype(np.int32)
    energy = potts_energy(labels, costs, ends, strength)
    starts, other, weight = adjacency(nodes, ends, strength)
    total = np.bincount(ends.T.ravel(), np.tile(strength, 2), nodes)
    by_label = np.ascontiguousarray(costs.T)  # a column of a large matrix misses the cache at every node
    keep = costs[np.arange(nodes), labels]
    since_change = 0  # labels tried since the last move that lowered the energy; after all of them, none can
    for _ in range(max_sweeps):
        for alpha in range(label_count):
            if since_change >= label_count:
                break
            since_change += 1
            rise = by_label[alpha] - keep  # what switching to alpha adds to the unary cost of every node
            chosen = _candidates(labels, alpha, rise, starts, other, weight, total)
            if len(chosen) == 0:
                continue
            moved = chosen[binary_cut(*_binary_problem(labels, alpha, rise, starts, other, weight, chosen))]
            change = _energy_change(labels, moved, alpha, rise, starts, other, weight)
            # Rounding alone must not keep the loop alive.
            if change < -1e-9 * max(1.0, abs(energy)):
                labels[moved], keep[moved] = alpha, by_label[alpha, moved]
                energy, since_change = energy + change, 0
    return labels, potts_energy(labels, costs, ends, strength)


@jit
def _energy_change(labels, moved, alpha, rise, starts, other, weight):
    # Of the energy, where the labels of the nodes ``moved`` become ``alpha``.
    after = labels.copy()
    after[moved] = alpha
    change = 0.0
    for n in moved:
        change += rise[n]
        for e in range(starts[n], starts[n + 1]):
            m = other[e]
            if after[m] == labels[m] or n < m:  # an edge of two moved nodes once
                change += weight[e] * ((after[m] != alpha) - (labels[m] != labels[n]))
    return change


@jit
def _candidates(labels, alpha, rise, starts, other, weight, total):
    # The (K,) int64 nodes, in order, that can be in a set whose switch lowers the energy. In the best case all
    # neighbors of a node that may switch do, which saves all its edges to them and to ``alpha``. Where that does not
    # outweigh ``rise``, the node stays, which raises the cost of switching for its neighbors, and so on.
    slack = rise - total
    slack[labels == alpha] = np.inf
    stay = np.empty(labels.size + 1, np.int64)
    count = 0
    for n in range(labels.size):
        stay[count] = n  # counted if it stays; a branch would be predicted wrong half of the times
        count += (slack[n] >= 0.0) & (labels[n] != alpha)
    k = 0
    while k < count:
        n = stay[k]
        k += 1
        for e in range(starts[n], starts[n + 1]):
            m = other[e]
            before = slack[m]
            slack[m] = before + weight[e] * (2.0 - np.float64(labels[m] != labels[n]))
            stay[count] = m
            count += (before < 0.0) & (slack[m] >= 0.0)
    return np.flatnonzero(slack < 0.0)


@jit
def _binary_problem(labels, alpha, rise, starts, other, weight, chosen):
    # Cost of x = 1 (switch) minus cost of x = 0 of the ``chosen`` nodes, and the edges between them.
    # Pair costs are E(0,0) = cut (0 where both have one label now), E(0,1) = E(1,0) = w, E(1,1) = 0, that is
    # E00 + (w - E00) x_p - w x_q + (2 w - E00) (1 - x_p) x_q. A neighbor at alpha adds w to x = 0;
    # one that stays elsewhere adds its cut cost to x = 0 and w to x = 1.
    index = np.full(labels.size, -1, np.int64)
    links = 0
    for k in range(chosen.size):
        index[chosen[k]] = k
        links += starts[chosen[k] + 1] - starts[chosen[k]]
    cost_of_true = np.empty(chosen.size, np.float64)
    p = np.empty(links, np.int64)
    q = np.empty(links, np.int64)
    capacity = np.empty(links, np.float64)
    count = 0
    for k in range(chosen.size):
        n = chosen[k]
        cost = rise[n]
        for e in range(starts[n], starts[n + 1]):
            m = other[e]
            w = weight[e]
            cut = w if labels[m] != labels[n] else 0.0
            if index[m] < 0:
                cost += -w if labels[m] == alpha else w - cut
            elif n < m:
                cost += w - cut
                p[count] = k
                q[count] = index[m]
                capacity[count] = 2.0 * w - cut
                count += 1
            else:
                cost -= w
        cost_of_true[k] = cost
    return cost_of_true, p[:count].copy(), q[:count].copy(), capacity[:count].copy()
