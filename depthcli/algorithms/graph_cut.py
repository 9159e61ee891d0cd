"""Labels of minimum energy by graph cuts: exact for two labels, by alpha expansion for more."""

from __future__ import annotations

from typing import Any, NamedTuple

import maxflow
import numpy as np
from numpy.typing import ArrayLike, NDArray

from depthcli.core.maps import Doubles, Ints, Mask
from depthcli.kernels.jit import empty, helper, jit, zeros


def binary_cut(cost_of_true: Doubles, p: NDArray[np.int64], q: NDArray[np.int64], capacity: Doubles) -> Mask:
    """Return the labels x that minimize ``sum cost_of_true x + sum capacity (1 - x_p) x_q`` on a graph, (N,) bool.

    ``cost_of_true`` (N,) is relative to the cost of false. The (E,) pairs of nodes (p, q) have costs ``capacity`` >= 0.
    """
    graph: Any = maxflow.GraphFloat(len(cost_of_true), len(p))
    ids = graph.add_nodes(len(cost_of_true))
    # The source side is x = 0. A cut terminal edge belongs to the terminal on the other side than the node.
    graph.add_grid_tedges(ids, np.maximum(cost_of_true, 0.0), np.maximum(-cost_of_true, 0.0))
    if len(p):
        graph.add_edges(p, q, capacity, np.zeros_like(capacity))
    graph.maxflow()
    labels: Mask = graph.get_grid_segments(ids)
    return labels


STEPS = ((0, 1), (1, 0), (1, 1), (1, -1))
"""Offsets (row, column) from each pixel to four of its eight neighbors; the other four are the reverse offsets."""


def edge_ends(shape: tuple[int, int], step: tuple[int, int]) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Return two pairs of slices: the pixels that have a neighbor at offset ``step``, and these neighbors."""
    (height, width), (dy, dx) = shape, step
    left, right = slice(max(-dx, 0), max(width - max(dx, 0), 0)), slice(max(dx, 0), max(width + min(dx, 0), 0))
    return (slice(0, max(height - dy, 0)), left), (slice(dy, height), right)


def grid_cut(gain_of_true: NDArray[np.floating[Any]], weights: tuple[NDArray[np.floating[Any]], ...]) -> Mask:
    """Return the labels x that maximize ``sum gain_of_true x - sum weight |x_p - x_q|`` over pixels with 8 neighbors.

    ``gain_of_true`` and the labels are (H, W). There is one array of weights >= 0 for each of :data:`STEPS`, with the
    shape of the first pair of slices from :func:`edge_ends`.
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
    labels: Mask = graph.get_grid_segments(nodes)
    return labels


def potts_energy(labels: ArrayLike, unary: ArrayLike, edges: ArrayLike, weights: ArrayLike) -> float:
    """Return the sum of ``unary[n, labels[n]]`` and the weights of all edges whose ends have different labels."""
    labels = np.asarray(labels)
    ends = np.asarray(edges, dtype=np.int64).reshape(-1, 2)
    data = np.asarray(unary)[np.arange(labels.size), labels].sum()
    return float(data + np.asarray(weights)[labels[ends[:, 0]] != labels[ends[:, 1]]].sum())


def alpha_expansion(
    unary: ArrayLike, edges: ArrayLike, weights: ArrayLike, initial: ArrayLike | None = None, max_sweeps: int = 20
) -> tuple[Ints, float]:
    """Return (N,) labels of small Potts energy on a graph, and the energy (Boykov, Veksler and Zabih, PAMI 2001).

    Parameters
    ----------
    unary : (N, L) finite costs of every label at every node
    edges : (E, 2) node indices, each edge once, no loops; E may be 0
    weights : (E,) costs >= 0 of an edge whose ends have different labels
    initial : (N,) labels to start from; the result's energy is not larger. Default: the cheapest label of every node
    max_sweeps : largest number of passes over all labels; ends earlier if no move lowers the energy
    """
    costs = np.ascontiguousarray(unary, dtype=np.float64)
    ends = np.ascontiguousarray(edges, dtype=np.int32).reshape(-1, 2)
    strength = np.ascontiguousarray(weights, dtype=np.float64)
    labels = np.argmin(costs, axis=1) if initial is None else np.array(initial)
    labels = labels.astype(np.int32)
    energy = potts_energy(labels, costs, ends, strength)
    # Transposed, since a column of a large matrix misses the cache at every node.
    _expand(labels, np.ascontiguousarray(costs.T), _arcs(len(costs), ends, strength), energy, max_sweeps)
    return labels, potts_energy(labels, costs, ends, strength)


class _Arcs(NamedTuple):
    # The edges of a graph in both directions; arcs from node n are starts[n] .. starts[n + 1] - 1.
    starts: NDArray[np.int64]
    end: Ints
    reverse: Ints  # the index of the arc in the opposite direction
    weight: Doubles


@jit
def _arcs(count, edges, weights):
    starts = zeros(count + 1, np.int64)
    for e in range(len(edges)):
        for n in edges[e]:
            starts[n + 1] += 1
    for n in range(count):
        starts[n + 1] += starts[n]
    free = starts[:count].copy()
    end, reverse = empty(starts[count], np.int32), empty(starts[count], np.int32)
    weight = empty(starts[count], np.float64)
    for e in range(len(edges)):
        p, q = edges[e]
        there, back = free[p], free[q]
        end[there], reverse[there], weight[there] = q, back, weights[e]
        end[back], reverse[back], weight[back] = p, there, weights[e]
        free[p] += 1
        free[q] += 1
    return _Arcs(starts, end, reverse, weight)


# A move switches a set of nodes to the label alpha. If two nodes with one label may switch, the cost of their edge
# becomes w |x_p - x_q|. If their labels differ, the cost falls by w x_p x_q = w / 2 (x_p + x_q) - w / 2 |x_p - x_q|. So
# each node has a gain from switching, and edges have capacities w or w / 2. Gains flow along edges to nodes that lose
# by switching. Nodes with a gain that cannot be absorbed switch, together with all nodes that such a gain reaches. This
# is the minimum cut with the fewest nodes on the side of alpha. Nearby nodes absorb most gains, so that few nodes of
# the graph are visited.


@jit
def _expand(labels, by_label, arcs, energy, max_sweeps):
    n_labels, nodes = by_label.shape
    capacity, rest = np.empty_like(arcs.weight), np.empty_like(arcs.weight)
    base = empty(nodes, np.float64)  # cost of the node's label, plus half the weights of edges to other labels
    tiny = 0.0  # smaller gains and capacities are rounding errors
    for n in range(nodes):
        _renew(n, labels, by_label, arcs, capacity, rest, base)
        tiny = max(tiny, 1e-12 * np.sum(arcs.weight[arcs.starts[n] : arcs.starts[n + 1]]))
    gain = empty(nodes, np.float64)
    height, number = zeros(nodes, np.int32), zeros(nodes + 2, np.int32)
    raised, queue = empty(nodes + 1, np.int32), empty(nodes, np.int32)
    moves = zeros(nodes, np.bool_)
    since_change = 0  # labels tried since the last move that lowered the energy
    for turn in range(max_sweeps * n_labels):
        if since_change >= n_labels:
            break
        since_change += 1
        alpha = turn % n_labels
        costs = by_label[alpha]
        for n in range(nodes):
            gain[n] = base[n] - costs[n]
        for n in range(nodes):
            if labels[n] == alpha:
                height[n] = _CLOSED
                for e in range(arcs.starts[n], arcs.starts[n + 1]):
                    gain[arcs.end[e]] += capacity[e]
        n_raised = _absorb(arcs, rest, gain, tiny, height, number, raised, queue)
        n_moved = _reached(raised[:n_raised], labels, alpha, arcs, rest, gain, tiny, moves, queue)
        moved = queue[:n_moved]
        change = 0.0
        for n in moved:
            change += costs[n] - by_label[labels[n], n]
            for e in range(arcs.starts[n], arcs.starts[n + 1]):
                m = arcs.end[e]
                if not moves[m] or n < m:  # count an edge between two moved nodes once
                    after = labels[m] != alpha and not moves[m]
                    change += arcs.weight[e] * (np.float64(after) - np.float64(labels[m] != labels[n]))
        for n in raised[:n_raised]:
            for e in range(arcs.starts[n], arcs.starts[n + 1]):
                rest[e], rest[arcs.reverse[e]] = capacity[e], capacity[arcs.reverse[e]]
        height[:] = 0
        # Rounding errors must not continue the loop.
        if change < -1e-9 * max(1.0, abs(energy)):
            energy, since_change = energy + change, 0
            labels[moved] = alpha
            for n in moved:
                _renew(n, labels, by_label, arcs, capacity, rest, base)
                for m in arcs.end[arcs.starts[n] : arcs.starts[n + 1]]:
                    if not moves[m]:
                        _renew(np.int64(m), labels, by_label, arcs, capacity, rest, base)
        moves[moved] = False


@helper
def _renew(n, labels, by_label, arcs, capacity, rest, base):
    # Update capacities and base cost of node n from the labels of n and its neighbors.
    base[n] = by_label[labels[n], n]
    for e in range(arcs.starts[n], arcs.starts[n + 1]):
        half = 0.5 * arcs.weight[e]
        cut = labels[arcs.end[e]] != labels[n]
        capacity[e] = rest[e] = half if cut else 2.0 * half
        base[n] += half if cut else 0.0


_CLOSED = 1 << 30  # height of nodes without a path to a node that absorbs gains


@helper
def _absorb(arcs, rest, gain, tiny, height, number, raised, queue):
    # Let gains flow to nodes with negative gains within the residual capacities ``rest``, by push-relabel (Goldberg and
    # Tarjan, JACM 1988). A gain flows to a neighbor one step lower. A node without a lower neighbor rises above its
    # lowest neighbor. If no node has some height, gains above this height cannot be absorbed. ``number`` counts nodes
    # by height. Before the call, all heights and numbers are 0, except the heights of nodes that do not take part.
    # Return the count of nodes in ``raised``, whose height has changed.
    count = 0
    for n in range(gain.size):
        raised[count] = n  # counted if it rises; a branch would often be mispredicted
        count += (gain[n] > tiny) & (height[n] == 0)
    waiting = count
    for k in range(count):
        queue[k] = raised[k]
    height[raised[:count]] = 1
    number[1] = count
    while waiting:
        waiting -= 1
        n = queue[waiting]
        while height[n] < _CLOSED:
            below, lowest = height[n] - 1, _CLOSED
            for e in range(arcs.starts[n], arcs.starts[n + 1]):
                if rest[e] <= tiny:
                    continue
                m = arcs.end[e]
                if height[m] != below:
                    lowest = min(lowest, height[m])
                    continue
                flow = min(gain[n], rest[e])
                rest[e] -= flow
                rest[arcs.reverse[e]] += flow
                gain[n] -= flow
                waits = gain[m] > tiny
                gain[m] += flow
                if gain[m] > tiny and not waits:
                    queue[waiting] = m
                    waiting += 1
                if gain[n] <= tiny:
                    break
            if gain[n] <= tiny:
                break
            old = height[n]
            height[n] = lowest + 1 if lowest < _CLOSED else _CLOSED
            if old == 0:
                raised[count] = n
                count += 1
            else:
                number[old] -= 1
            if old > 0 and number[old] == 0:
                for k in range(count):
                    m = raised[k]
                    if old < height[m] < _CLOSED:
                        number[height[m]] -= m != n
                        height[m] = _CLOSED
            elif lowest < _CLOSED:
                number[height[n]] += 1
    for k in range(count):
        if height[raised[k]] < _CLOSED:
            number[height[raised[k]]] = 0
    return count


@helper
def _reached(raised, labels, alpha, arcs, rest, gain, tiny, moves, queue):
    # Mark the nodes that remaining gains reach, list them in the queue, and return their number.
    count = 0
    for n in raised:
        if gain[n] > tiny:
            moves[n] = True
            queue[count] = n
            count += 1
    k = 0
    while k < count:
        n = queue[k]
        k += 1
        for e in range(arcs.starts[n], arcs.starts[n + 1]):
            m = arcs.end[e]
            if rest[e] > tiny and not moves[m] and labels[m] != alpha:
                moves[m] = True
                queue[count] = m
                count += 1
    return count
