"""One minimum cut on a grid against all labellings, and alpha-expansion against brute force on small graphs."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from depthcli.algorithms.graph_cut import STEPS, alpha_expansion, binary_cut, edge_ends, grid_cut, potts_energy
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
