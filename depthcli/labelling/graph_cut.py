"""Alpha-expansion for Potts energies on arbitrary graphs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import maxflow
import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True)
class Labelling:
    """Result of :func:`alpha_expansion`.

    Attributes
    ----------
    labels : (N,) int32
    energy_before : energy of the initial labels
    energy : energy of ``labels``; never above ``energy_before``
    sweeps : passes over all labels that were needed
    """

    labels: NDArray[np.int32]
    energy_before: float
    energy: float
    sweeps: int


def potts_energy(labels: ArrayLike, unary: ArrayLike, edges: ArrayLike, weights: ArrayLike) -> float:
    """Sum of ``unary[n, labels[n]]`` and of the weights of all edges whose ends differ in label."""
    labels = np.asarray(labels)
    ends = np.asarray(edges, dtype=np.int64).reshape(-1, 2)
    data = np.asarray(unary)[np.arange(labels.size), labels].sum()
    return float(data + np.asarray(weights)[labels[ends[:, 0]] != labels[ends[:, 1]]].sum())


def alpha_expansion(
    unary: ArrayLike,
    edges: ArrayLike,
    weights: ArrayLike,
    initial: ArrayLike | None = None,
    max_sweeps: int = 20,
) -> Labelling:
    """Minimize a Potts energy over a graph (Boykov, Veksler and Zabih, PAMI 2001).

    Parameters
    ----------
    unary : (N, L) finite costs of every label at every node
    edges : (E, 2) node indices, each edge once, no loops; E may be 0
    weights : (E,) costs >= 0 of an edge whose ends have different labels
    initial : (N,) labels to start from; the cheapest label of every node where not given
    max_sweeps : passes over all labels; stops earlier where no move lowers the energy

    Returns
    -------
    Labelling
        Deterministic: the same input gives the same labels.

    Raises
    ------
    ValueError
        For shapes that do not fit, values that are not finite, negative weights, or no labels.
    """
    costs = np.ascontiguousarray(unary, dtype=np.float64)
    ends = np.ascontiguousarray(edges, dtype=np.int32).reshape(-1, 2)
    strength = np.ascontiguousarray(weights, dtype=np.float64)
    _check(costs, ends, strength)
    nodes, label_count = costs.shape
    labels = np.argmin(costs, axis=1) if initial is None else np.array(initial)
    labels = labels.astype(np.int32)
    if labels.shape != (nodes,) or (nodes and not 0 <= labels.min() <= labels.max() < label_count):
        raise ValueError(f"want {nodes} initial labels in [0, {label_count})")

    before = potts_energy(labels, costs, ends, strength)
    energy = before
    incident = np.zeros(nodes) + np.bincount(ends[:, 0], strength, nodes) + np.bincount(ends[:, 1], strength, nodes)
    by_label = np.ascontiguousarray(costs.T)  # a column of a large matrix misses the cache at every node
    keep = costs[np.arange(nodes), labels]
    since_change = 0  # labels tried since the last move that helped: after all of them, nothing can
    sweeps = 0
    while sweeps < max_sweeps and since_change < label_count:
        sweeps += 1
        for alpha in range(label_count):
            if since_change >= label_count:
                break
            since_change += 1
            moved = _expand(labels, alpha, keep, by_label[alpha], ends, strength, incident)
            if moved is None:
                continue
            moved_energy = potts_energy(moved, costs, ends, strength)
            # Rounding alone must not keep the loop alive.
            if moved_energy < energy - 1e-9 * max(1.0, abs(energy)):
                labels, energy, since_change = moved, moved_energy, 0
                keep = costs[np.arange(nodes), labels]
    return Labelling(labels, before, energy, sweeps)


def _check(costs: NDArray[np.float64], ends: NDArray[np.int32], strength: NDArray[np.float64]) -> None:
    if costs.ndim != 2 or costs.shape[1] == 0:
        raise ValueError(f"want unary costs (N, L) with L > 0, got {costs.shape}")
    if strength.shape != (len(ends),):
        raise ValueError(f"want {len(ends)} weights, one an edge, got {strength.shape}")
    if not (np.isfinite(costs).all() and np.isfinite(strength).all()):
        raise ValueError("unary costs and weights must be finite")
    if len(ends) and (strength.min() < 0 or ends.min() < 0 or ends.max() >= len(costs)):
        raise ValueError("want weights >= 0 and edges between existing nodes")
    if len(ends) and np.any(ends[:, 0] == ends[:, 1]):
        raise ValueError("an edge must join two different nodes")


def _expand(
    labels: NDArray[np.int32],
    alpha: int,
    keep: NDArray[np.float64],
    switch: NDArray[np.float64],
    ends: NDArray[np.int32],
    strength: NDArray[np.float64],
    incident: NDArray[np.float64],
) -> NDArray[np.int32] | None:
    """The best labels among those where any set of nodes switched to ``alpha``; None = no better ones."""
    nodes = len(labels)
    rise = switch - keep  # what switching costs a node by itself
    # Whatever the others do, a switch saves a node at most all its edges: where it costs more, it stays.
    movable = (labels != alpha) & (rise < incident)
    if not movable.any():
        return None
    near = movable[ends[:, 0]] | movable[ends[:, 1]]
    first, second, strength = ends[near, 0], ends[near, 1], strength[near]
    cut = strength * (labels[first] != labels[second])
    # At best a switch saves every cut edge at the node. Where not even that pays for any node, no set
    # of nodes can gain: each edge of the set is counted at least once.
    saved = np.bincount(first, cut, nodes) + np.bincount(second, cut, nodes)
    if not np.any(movable & (rise < saved)):
        return None

    # Binary problem over the movable nodes, x = 1 means alpha. Pair costs are E(0,0) = cut (or 0),
    # E(0,1) = E(1,0) = w, E(1,1) = 0. A neighbor that is at alpha adds w to x = 0; one that stays
    # elsewhere adds its cut cost to x = 0 and w to x = 1.
    index = np.cumsum(movable, dtype=np.int32) - 1
    both = movable[first] & movable[second]
    p, q, same_pair, w = index[first[both]], index[second[both]], cut[both], strength[both]
    count = int(movable.sum())
    score = rise[movable]  # cost of x = 1 minus cost of x = 0
    # E(0,0) + (w - E00) x_p + (0 - w) x_q + (2 w - E00) (1 - x_p) x_q
    score += np.bincount(p, w - same_pair, count) - np.bincount(q, w, count)
    for one, other in ((first, second), (second, first)):
        fixed = movable[one] & ~movable[other]
        there = np.where(labels[other[fixed]] == alpha, -strength[fixed], strength[fixed] - cut[fixed])
        score += np.bincount(index[one[fixed]], there, count)

    graph: Any = maxflow.GraphFloat(count, len(p))
    ids = graph.add_nodes(count)
    # Source side is x = 0: a terminal edge that is cut belongs to the side the node is not on.
    graph.add_grid_tedges(ids, np.maximum(score, 0.0), np.maximum(-score, 0.0))
    if len(p):
        graph.add_edges(ids[p], ids[q], 2.0 * w - same_pair, np.zeros_like(w))
    graph.maxflow()
    chosen = graph.get_grid_segments(ids)
    if not chosen.any():
        return None
    moved = labels.copy()
    moved[np.flatnonzero(movable)[chosen]] = alpha
    return moved
