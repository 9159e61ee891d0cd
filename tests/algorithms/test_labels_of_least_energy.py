"""Minimum cuts, alpha-expansion and TRW-S, against all labelings of small graphs."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from depthcli.algorithms.graph_cut import STEPS, alpha_expansion, binary_cut, edge_ends, grid_cut, potts_energy
from depthcli.algorithms.trws import trws
from depthcli.testing.inputs import assert_pure
from tests.naive import segments as naive


def _weights(rng, shape):
    return tuple(rng.random(np.empty(shape)[edge_ends(shape, step)[0]].shape) for step in STEPS)


def _value(labels, score, weights):
    """Pixel by pixel, as the formula says."""
    total = (score * labels).sum()
    for (down, across), weight in zip(STEPS, weights, strict=True):
        first = max(0, -across)
        for y, x in itertools.product(range(weight.shape[0]), range(weight.shape[1])):
            total -= weight[y, x] * (labels[y, x + first] != labels[y + down, x + first + across])
    return total


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (5, 1), (2, 2), (3, 3), (2, 5)])
@pytest.mark.parametrize("seed", range(5))
def test_no_labelling_is_better(shape, seed):
    rng = np.random.default_rng(seed)
    score, weights = rng.normal(0, 1, shape), _weights(rng, shape)
    copies = [score.copy(), *(weight.copy() for weight in weights)]
    found = grid_cut(score, weights)
    all_of = (np.reshape(labels, shape) for labels in itertools.product((False, True), repeat=score.size))
    assert _value(found, score, weights) == pytest.approx(max(_value(each, score, weights) for each in all_of))
    for array, copy in zip((score, *weights), copies, strict=True):
        np.testing.assert_array_equal(array, copy)


def _problem(seed, nodes, labels):
    rng = np.random.default_rng(seed)
    pairs = [(i, j) for i in range(nodes) for j in range(i + 1, nodes) if rng.random() < 0.6]
    edges = np.array(pairs, np.int32).reshape(-1, 2)
    return rng.random((nodes, labels)), edges, rng.random(len(edges))


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 6), st.integers(1, 4))
def test_no_expansion_can_lower_the_result(seed, nodes, labels):
    unary, edges, weights = _problem(seed, nodes, labels)
    chosen, energy = alpha_expansion(unary, edges, weights)
    assert energy == pytest.approx(naive.potts(chosen, unary, edges, weights))
    assert energy <= potts_energy(unary.argmin(axis=1), unary, edges, weights)
    for alpha in range(labels):
        assert naive.best_expansion(chosen, alpha, unary, edges, weights) >= energy - 1e-9


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 80), st.sampled_from([0.05, 0.5, 5.0]))
def test_a_move_is_a_minimum_cut(seed, nodes, strength):
    rng = np.random.default_rng(seed)
    edges = np.unique(np.sort(rng.integers(0, nodes, (3 * nodes, 2)), axis=1), axis=0).astype(np.int32)
    edges = edges[edges[:, 0] != edges[:, 1]]
    unary, weights = rng.random((nodes, 2)), strength * rng.random(len(edges))
    labels, energy = alpha_expansion(unary, edges, weights, np.zeros(nodes, int), max_sweeps=1)
    p, q = np.concatenate([edges, edges[:, ::-1]]).T
    cut = binary_cut(unary[:, 1] - unary[:, 0], p, q, np.tile(weights, 2))
    assert energy == pytest.approx(potts_energy(cut.astype(int), unary, edges, weights))
    assert np.array_equal(labels, cut)


def test_nodes_keep_a_label_as_good_as_any_other():
    unary = np.array([[5.0, 5.0, 0.0]] + [[0.1, 0.1, 0.1]] * 4)
    edges, weights = np.array([[0, 1], [1, 2], [2, 3], [3, 4], [1, 3]]), np.array([0.3, 0.1, 0.7, 0.2, 0.9])
    labels, energy = alpha_expansion(unary, edges, weights, np.array([2, 0, 1, 1, 2]))
    assert energy == pytest.approx(0.4) and labels.tolist() == [2] * 5
    keep = np.array([0, 1, 1, 1, 0])
    assert np.array_equal(alpha_expansion(np.zeros((5, 3)), np.zeros((0, 2)), np.zeros(0), keep)[0], keep)


def test_starts_from_the_given_labels_and_leaves_inputs_alone():
    unary, edges, weights = _problem(5, 6, 3)
    copies = unary.copy(), edges.copy(), weights.copy()
    initial = np.array([0, 1, 2, 0, 1, 2])
    labels, energy = alpha_expansion(unary, edges, weights, initial, max_sweeps=0)
    assert np.array_equal(labels, initial) and energy == potts_energy(initial, unary, edges, weights)
    assert alpha_expansion(unary, edges, weights, initial)[1] <= energy
    for array, copy in zip((unary, edges, weights, initial), (*copies, [0, 1, 2, 0, 1, 2]), strict=True):
        assert np.array_equal(array, copy)


def pairs_of(active, weights):
    """Node, neighbor and weight of every pair of active neighbors."""
    index = np.full(active.shape, -1)
    index[active] = np.arange(active.sum())
    for y, x in np.argwhere(active):
        for k, (dy, dx) in enumerate(((0, 1), (1, -1), (1, 0), (1, 1))):
            v, u = y + dy, x + dx
            if 0 <= v < active.shape[0] and 0 <= u < active.shape[1] and active[v, u]:
                yield index[y, x], index[v, u], weights[index[y, x], k]


def energy_of(labels, values, unary, pairs, truncation):
    chosen = values[np.arange(len(labels)), labels]
    cost = unary[np.arange(len(labels)), labels].sum(dtype=float)
    return cost + sum(w * min(abs(float(chosen[a]) - float(chosen[b])), truncation) for a, b, w in pairs)


def best_energy(values, unary, pairs, truncation):
    choices = [range(int(np.isfinite(row).sum())) for row in unary]
    return min(energy_of(np.array(c), values, unary, pairs, truncation) for c in itertools.product(*choices))


def random_problem(rng, active, labels=3):
    n = int(active.sum())
    values = rng.normal(0, 3, (n, labels)).astype(np.float32)
    unary = rng.exponential(1, (n, labels)).astype(np.float32)
    unary[rng.random(n) < 0.3, labels - 1] = np.inf
    return values, unary, rng.exponential(0.5, (n, 4)).astype(np.float32)


def solved(rng, active, truncation, sweeps):
    """The energy that is found, and the least one."""
    values, unary, weights = random_problem(rng, active)
    labels, pairs = trws(values, unary, active, weights, truncation, sweeps), list(pairs_of(active, weights))
    return energy_of(labels, values, unary, pairs, truncation), best_energy(values, unary, pairs, truncation)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(25))
def test_near_the_optimum_on_tiny_grids(seed):
    rng = np.random.default_rng(seed)
    active = rng.random(tuple(rng.integers(1, 5, 2))) < 0.75
    active.flat[np.flatnonzero(active)[9:]] = False
    found, best = solved(rng, active, 4.0, 40)
    assert found <= best + 0.05 * abs(best)


@pytest.mark.parametrize("shape", [(1, 9), (9, 1)])
@pytest.mark.parametrize("seed", range(5))
def test_exact_on_chains(shape, seed):
    found, best = solved(np.random.default_rng(seed), np.ones(shape, bool), 2.0, 3)
    assert found == pytest.approx(best, abs=1e-4)


def test_the_answer_is_the_same_at_any_number_of_threads():
    rng = np.random.default_rng(3)
    active = rng.random((97, 61)) < 0.8
    values, unary, weights = random_problem(rng, active, 4)
    assert_pure(lambda: trws(values, unary, active, weights, 4.0, 8), values, unary, active, weights)
    pairs, labels = list(pairs_of(active, weights)), trws(values, unary, active, weights, 4.0, 8)
    found, first = (energy_of(each, values, unary, pairs, 4.0) for each in (labels, unary.argmin(axis=1)))
    assert found < first
    assert trws(values[:0], unary[:0], np.zeros((2, 3), bool), weights[:0], 4.0, 8).shape == (0,)
