"""Alpha-expansion against brute force on small graphs."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from depthcli.algorithms.graph_cut import alpha_expansion, potts_energy
from tests.naive import segments as naive


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


def test_starts_from_the_given_labels_and_leaves_inputs_alone():
    unary, edges, weights = _problem(5, 6, 3)
    copies = unary.copy(), edges.copy(), weights.copy()
    initial = np.array([0, 1, 2, 0, 1, 2])
    labels, energy = alpha_expansion(unary, edges, weights, initial, max_sweeps=0)
    assert np.array_equal(labels, initial)
    assert energy == potts_energy(initial, unary, edges, weights)
    assert alpha_expansion(unary, edges, weights, initial)[1] <= energy
    for array, copy in zip((unary, edges, weights), copies, strict=True):
        assert np.array_equal(array, copy)
    assert np.array_equal(initial, [0, 1, 2, 0, 1, 2])
