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
