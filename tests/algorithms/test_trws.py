"""TRW-S on pixel grids, against all labellings."""

import itertools

import numpy as np
import pytest

from depthcli.algorithms.trws import trws
from depthcli.testing.inputs import assert_pure

STEPS = ((0, 1), (1, -1), (1, 0), (1, 1))


def pairs_of(active, weights):
    """Node, neighbor and weight of every pair of active neighbors."""
    index = np.full(active.shape, -1)
    index[active] = np.arange(active.sum())
    for y, x in np.argwhere(active):
        for k, (dy, dx) in enumerate(STEPS):
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


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(25))
def test_near_the_optimum_on_tiny_grids(seed):
    rng = np.random.default_rng(seed)
    active = rng.random(tuple(rng.integers(1, 5, 2))) < 0.75
    active.flat[np.flatnonzero(active)[9:]] = False
    values, unary, weights = random_problem(rng, active)
    labels = trws(values, unary, active, weights, 4.0, 40)
    pairs = list(pairs_of(active, weights))
    if not active.any():
        assert labels.shape == (0,)
        return
    best = best_energy(values, unary, pairs, 4.0)
    assert energy_of(labels, values, unary, pairs, 4.0) <= best + 0.05 * abs(best)


@pytest.mark.parametrize("shape", [(1, 9), (9, 1)])
@pytest.mark.parametrize("seed", range(5))
def test_exact_on_chains(shape, seed):
    rng = np.random.default_rng(seed)
    active = np.ones(shape, bool)
    values, unary, weights = random_problem(rng, active)
    labels = trws(values, unary, active, weights, 2.0, 3)
    pairs = list(pairs_of(active, weights))
    best = best_energy(values, unary, pairs, 2.0)
    assert energy_of(labels, values, unary, pairs, 2.0) == pytest.approx(best, abs=1e-4)


def test_the_answer_is_the_same_at_any_number_of_threads():
    rng = np.random.default_rng(3)
    active = rng.random((97, 61)) < 0.8
    values, unary, weights = random_problem(rng, active, 4)
    assert_pure(lambda: trws(values, unary, active, weights, 4.0, 8), values, unary, active, weights)
    labels, pairs = trws(values, unary, active, weights, 4.0, 8), list(pairs_of(active, weights))
    energy = energy_of(labels, values, unary, pairs, 4.0)
    first = np.where(np.isfinite(unary), unary, np.inf).argmin(axis=1)
    assert energy < energy_of(first, values, unary, pairs, 4.0)
