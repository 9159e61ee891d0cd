"""Figures of registration confidence: expected errors of points against the true ones."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.evaluation.curves import sparsification
from depthcli.evaluation.scores import Metric, Score, percent
from depthcli.evaluation.statistics import correlation, ranks, roc_area

Errors = NDArray[np.float32]

LIMITS_MM = (3.0, 6.0)
"""A point is correct below the first, poor below the second, and wrong from there on (Sokooti et al. 2019)."""

HEADLINE = Metric("Spearman", "", worst=-1.0, larger_is_better=True)
"""Rank correlation of expected and true errors."""

_WORST_SHARE = 0.3  # of TRE30, the robustness of Learn2Reg


def error_classes(error: NDArray[np.floating[Any]]) -> NDArray[np.intp]:
    """Return 0 for errors below 3 mm, 1 below 6 mm, and 2 from there on."""
    return np.searchsorted(LIMITS_MM, error, side="right")


def point_scores(region: str, expected: Errors, true: Errors) -> list[Score]:
    """Compute every metric over points; expected errors that are not finite are unknown.

    Parameters
    ----------
    expected, true : (N,) float32, mm, N > 0
    """
    known = np.isfinite(expected)
    n_known = int(known.sum())
    e, t = expected[known].astype(np.float64), true[known].astype(np.float64)
    ordered = np.sort(true.astype(np.float64))
    worst = ordered[-max(1, round(_WORST_SHARE * len(true))) :]
    line = sparsification(-e, t) if n_known else None
    accuracy = 100 * float(np.mean(error_classes(e) == error_classes(t))) if n_known else np.nan
    values = (
        (HEADLINE, correlation(ranks(e), ranks(t))),
        (Metric("Pearson", "", worst=-1.0, larger_is_better=True), correlation(e, t)),
        (Metric("AUC", "", LIMITS_MM[0], worst=0.0, larger_is_better=True), roc_area(e, t > LIMITS_MM[0])),
        (Metric("accuracy", "%", worst=0.0, larger_is_better=True), accuracy),
        (Metric("MAE", "mm"), float(np.abs(e - t).mean()) if n_known else np.nan),
        (Metric("expected", "mm"), float(e.mean()) if n_known else np.nan),
        (Metric("AUSE", "mm"), np.nan if line is None else line.ause),
        (Metric("AURG", "mm", larger_is_better=True), np.nan if line is None else line.aurg),
        (Metric("TRE", "mm"), float(ordered.mean())),
        (Metric("TRE std", "mm"), float(ordered.std())),
        (Metric("TRE30", "mm"), float(worst.mean())),
    )
    density, n = percent(n_known, len(true)), len(true)
    return [Score(metric, region, value, n_known, density, region_pixels=n) for metric, value in values]
