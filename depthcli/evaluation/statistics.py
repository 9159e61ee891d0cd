"""Statistics over scenes, runs and points: means, ranks, correlation, ROC area, paired comparisons."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


def mean_of_known(values: Iterable[float]) -> float:
    """Return the mean of the values that are not NaN; NaN where there is none."""
    known = [v for v in values if not math.isnan(v)]
    return math.fsum(known) / len(known) if known else math.nan


def average_ranks(values: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Compute the mean rank of every method over all columns, as the Middlebury v2 table does; rank 1 is lowest.

    Parameters
    ----------
    values : (methods, columns), lower is better; equal values share their mean rank, NaN (no result) ranks last

    Returns
    -------
    (methods,) float64, NaN where there are no columns
    """
    if values.shape[1] == 0:
        return np.full(values.shape[0], np.nan)
    keys = np.where(np.isnan(values), np.inf, values.astype(np.float64))
    mean: NDArray[np.float64] = np.mean([ranks(column) for column in keys.T], axis=0)
    return mean


def ranks(values: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Return the rank of every value, from 1 for the lowest; equal values share their mean rank."""
    _, inverse, counts = np.unique(values, return_inverse=True, return_counts=True)
    shared: NDArray[np.float64] = (np.cumsum(counts) - (counts - 1) / 2.0)[inverse]
    return shared


def correlation(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Compute Pearson's correlation coefficient; NaN where one of the two does not vary."""
    if len(a) < 2 or np.ptp(a) == 0 or np.ptp(b) == 0:
        return math.nan
    return float(np.corrcoef(a, b)[0, 1])


def roc_area(score: NDArray[np.float64], positive: NDArray[np.bool_]) -> float:
    """Compute the area under the ROC curve: the chance that a positive has a higher score than a negative.

    NaN where all points are positive, or none is.
    """
    n = int(positive.sum())
    if n in (0, len(positive)):
        return math.nan
    return float((ranks(score)[positive].sum() - n * (n + 1) / 2) / (n * (len(positive) - n)))


@dataclass(frozen=True)
class PairedTest:
    """Method ``b`` against method ``a`` over the scenes that both have.

    Attributes
    ----------
    scenes : number of scenes compared
    wins, losses, ties : number of scenes where b is lower, higher, equal
    mean_difference : mean of b - a (negative: b is better)
    worst_ratio : largest b / a over the scenes (NaN where a is 0 everywhere)
    p_value : two-sided exact sign test; ties are left out
    """

    scenes: int
    wins: int
    losses: int
    ties: int
    mean_difference: float
    worst_ratio: float
    p_value: float


def compare(a: Sequence[float], b: Sequence[float]) -> PairedTest:
    """Compare two methods scene by scene; lower is better, pairs with a NaN are left out.

    Raises
    ------
    ValueError
        The sequences differ in length.
    """
    if len(a) != len(b):
        raise ValueError(f"want two sequences of one length, got {len(a)} and {len(b)}")
    pairs = [(x, y) for x, y in zip(a, b, strict=True) if not (math.isnan(x) or math.isnan(y))]
    wins = sum(y < x for x, y in pairs)
    losses = sum(y > x for x, y in pairs)
    return PairedTest(
        scenes=len(pairs),
        wins=wins,
        losses=losses,
        ties=len(pairs) - wins - losses,
        mean_difference=math.fsum(y - x for x, y in pairs) / len(pairs) if pairs else math.nan,
        worst_ratio=max((y / x for x, y in pairs if x > 0), default=math.nan),
        p_value=sign_test(wins, losses),
    )


def sign_test(wins: int, losses: int) -> float:
    """Return the two-sided exact p value of the sign test: the chance of a split at least so uneven."""
    n = wins + losses
    tail = sum(math.comb(n, k) for k in range(min(wins, losses) + 1))
    return min(1.0, float(2 * tail / 2**n))
