"""Statistics over scenes, runs and points: means, ranks, correlation, ROC area, paired tests and their correction."""

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
    rank_difference : rank-biserial correlation, -1 to 1: the sum of the ranks of b's losses less that of its wins, as
        a share of all ranks; the sign says which of the two the test speaks for (negative: b). 0 where all are ties
    p_value : two-sided Wilcoxon signed-rank test; ties are left out. NaN where no scene is compared
    """

    scenes: int
    wins: int
    losses: int
    ties: int
    mean_difference: float
    worst_ratio: float
    rank_difference: float
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
    differences = np.array([y - x for x, y in pairs if y != x], np.float64)
    weights = ranks(np.abs(differences))
    losses = int(np.count_nonzero(differences > 0))
    return PairedTest(
        scenes=len(pairs),
        wins=len(differences) - losses,
        losses=losses,
        ties=len(pairs) - len(differences),
        mean_difference=math.fsum(y - x for x, y in pairs) / len(pairs) if pairs else math.nan,
        worst_ratio=max((y / x for x, y in pairs if x > 0), default=math.nan),
        rank_difference=float((np.sign(differences) * weights).sum() / weights.sum()) if len(differences) else 0.0,
        p_value=signed_rank_test(differences) if pairs else math.nan,
    )


_MAX_ENUMERATED = 10  # differences, some of one size, whose 2^n signs are all tried: a few tenths of a second
_MAX_EXACT = 50  # of more the normal approximation, as in scipy


def signed_rank_test(differences: NDArray[np.float64]) -> float:
    """Return the two-sided p value of the Wilcoxon signed-rank test; 1 below two differences.

    It is exact up to 50 differences, or 10 where some are of one size; else a normal approximation.

    Parameters
    ----------
    differences : (n,), none of them 0
    """
    if len(differences) < 2:
        return 1.0
    from scipy.stats import PermutationMethod, wilcoxon  # takes a second to import

    tied = len(np.unique(np.abs(differences))) < len(differences)
    method: Any = "asymptotic" if tied or len(differences) > _MAX_EXACT else "exact"
    if tied and len(differences) <= _MAX_ENUMERATED:
        method = PermutationMethod(n_resamples=2**_MAX_ENUMERATED)
    return float(wilcoxon(differences, method=method).pvalue)


def smallest_p(n_scenes: int, n_tests: int) -> float:
    """Return the smallest p value that :func:`holm` can give for that many tests over that many scenes."""
    return min(1.0, n_tests * 2.0 ** (1 - n_scenes))


def holm(p_values: Sequence[float]) -> list[float]:
    """Return p values corrected for their number after Holm; NaN stays NaN and does not count."""
    corrected = [math.nan] * len(p_values)
    order = sorted((p, i) for i, p in enumerate(p_values) if not math.isnan(p))
    largest = 0.0
    for k, (p, i) in enumerate(order):
        largest = corrected[i] = max(largest, min(1.0, (len(order) - k) * p))
    return corrected
