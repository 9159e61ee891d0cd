"""One minimum cut on a grid, against all labellings."""

import itertools

import numpy as np
import pytest

from depthcli.algorithms.graph_cut import STEPS, edge_ends, grid_cut


def _weights(rng, shape, max_weight=1.0):
    return tuple(rng.random(np.empty(shape)[edge_ends(shape, step)[0]].shape) * max_weight for step in STEPS)


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
    best = max(
        _value(np.array(labels).reshape(shape), score, weights)
        for labels in itertools.product((False, True), repeat=score.size)
    )
    assert _value(found, score, weights) == pytest.approx(best)
    for array, copy in zip((score, *weights), copies, strict=True):
        np.testing.assert_array_equal(array, copy)
