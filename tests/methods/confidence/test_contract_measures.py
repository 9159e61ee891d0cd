"""What every confidence measure promises: the folder says which there are."""

from __future__ import annotations

import numpy as np
import pytest

from depthcli.methods.confidence import confidence_maps, measures
from tests.methods.stereo._pairs import assert_pure

HEIGHT, WIDTH, DISPARITIES, TRUE = 30, 60, 16, 5


def distinct_costs() -> np.ndarray:
    """Costs with one clear minimum and a far worse second one, at the same disparities everywhere and in both views."""
    curve = 10 + 12 * np.abs(np.arange(DISPARITIES) - TRUE)
    curve[TRUE + 6] -= 20
    return np.broadcast_to(curve.astype(np.uint8), (HEIGHT, WIDTH, DISPARITIES)).copy()


def ambiguous_costs(seed: int = 0) -> np.ndarray:
    """Costs that hardly differ: the minimum is where noise puts it."""
    return np.random.default_rng(seed).integers(100, 106, (HEIGHT, WIDTH, DISPARITIES)).astype(np.uint8)


@pytest.mark.parametrize("name", measures())
def test_a_distinct_minimum_has_a_higher_confidence_than_an_ambiguous_one(name: str):
    inner = np.s_[13:-13, DISPARITIES + 13 : -13]
    distinct = confidence_maps(distinct_costs(), [name])[name][inner]
    ambiguous = confidence_maps(ambiguous_costs(), [name])[name][inner]
    assert distinct.mean() > ambiguous.mean()


@pytest.mark.parametrize("name", measures())
def test_maps_are_finite_float32_of_the_images_size(name: str):
    for shape in ((1, 1, 1), (2, 3, 1), (3, 2, 17), (5, 31, 33)):
        costs = np.random.default_rng(1).integers(0, 200, shape).astype(np.uint8)
        values = confidence_maps(costs, [name])[name]
        assert values.shape == shape[:2]
        assert values.dtype == np.float32
        assert np.isfinite(values).all()


@pytest.mark.parametrize("name", measures())
def test_same_bytes_at_any_thread_count_and_costs_untouched(name: str):
    costs = ambiguous_costs(2)
    assert_pure(lambda: confidence_maps(costs, [name])[name], costs)
