"""What every confidence measure promises."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from depthcli.methods.confidence import ConfidenceMeasure, CostCurves, Map
from depthcli.testing.inputs import assert_pure, run_checks

_HEIGHT, _WIDTH, _DISPARITIES, _TRUE = 30, 60, 16, 5


def check_confidence_measure(measure: ConfidenceMeasure) -> None:
    """Raise AssertionError unless a confidence measure of stereo costs keeps all promises to pipelines."""
    run_checks(measure, CHECKS)


def _values(measure: ConfidenceMeasure, costs: NDArray[np.uint8]) -> Map:
    valid = np.minimum(np.arange(1, costs.shape[1] + 1, dtype=np.int32), costs.shape[2])
    return measure(CostCurves(costs, np.broadcast_to(valid, costs.shape[:2])))


def _distinct_costs() -> NDArray[np.uint8]:
    """Costs with one clear minimum and a far worse second one, at the same disparities everywhere and in both views."""
    curve = 10 + 12 * np.abs(np.arange(_DISPARITIES) - _TRUE)
    curve[_TRUE + 6] -= 20
    return np.broadcast_to(curve.astype(np.uint8), (_HEIGHT, _WIDTH, _DISPARITIES)).copy()


def _ambiguous_costs(seed: int = 0) -> NDArray[np.uint8]:
    """Costs that hardly differ, so that noise decides on the minimum."""
    return np.random.default_rng(seed).integers(100, 106, (_HEIGHT, _WIDTH, _DISPARITIES)).astype(np.uint8)


def a_distinct_minimum_is_surer(measure: ConfidenceMeasure) -> None:
    """Costs with a distinct minimum have a higher mean confidence than ambiguous ones."""
    inner = np.s_[13:-13, _DISPARITIES + 13 : -13]
    distinct, ambiguous = (_values(measure, c)[inner].mean() for c in (_distinct_costs(), _ambiguous_costs()))
    assert distinct > ambiguous, f"{distinct:.4g} of distinct minima, {ambiguous:.4g} of ambiguous ones"


def maps_are_finite_float32(measure: ConfidenceMeasure) -> None:
    """Volumes of any size give finite float32 values of the size of the image."""
    for shape in ((1, 1, 1), (2, 3, 1), (3, 2, 17), (5, 31, 33)):
        values = _values(measure, np.random.default_rng(1).integers(0, 200, shape).astype(np.uint8))
        assert values.shape == shape[:2], f"expected {shape[:2]}, got {values.shape}"
        assert values.dtype == np.float32, f"expected float32, got {values.dtype}"
        assert np.isfinite(values).all(), f"some values are NaN or infinite, of costs of shape {shape}"


def same_at_any_number_of_threads(measure: ConfidenceMeasure) -> None:
    """The map does not depend on the number of threads, and the costs stay as they were."""
    costs = _ambiguous_costs(2)
    assert_pure(lambda: _values(measure, costs), costs)


CHECKS = (a_distinct_minimum_is_surer, maps_are_finite_float32, same_at_any_number_of_threads)
"""One function a promise."""
