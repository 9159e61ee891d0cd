"""Statistics over scenes, runs and points: means, ranks, correlation, ROC area, paired tests, ranking of runs."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

SIGNIFICANT = 0.05
"""A difference is significant if its corrected p value is below this level."""

_MAX_ENUMERATED = 10  # differences, some of one size, whose 2^n signs are all tried: a few tenths of a second
_MAX_EXACT = 50  # of more the normal approximation, as in scipy
_MAX_NAMES = 3  # of runs in a sentence


def mean_of_known(values: Iterable[float]) -> float:
    """Return the mean of the values that are not NaN, or NaN if there are none."""
    known = [v for v in values if not math.isnan(v)]
    return math.fsum(known) / len(known) if known else math.nan


def average_ranks(values: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Return the mean rank of every method over (methods, columns), as the Middlebury v2 table does; 1 is lowest.

    Equal values share their mean rank, NaN (no result) ranks last; (methods,) float64, NaN without columns.
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
    """Compute Pearson's correlation coefficient; NaN if one of the two is constant."""
    if len(a) < 2 or np.ptp(a) == 0 or np.ptp(b) == 0:
        return math.nan
    return float(np.corrcoef(a, b)[0, 1])


def roc_area(score: NDArray[np.float64], positive: NDArray[np.bool_]) -> float:
    """Compute the area under the ROC curve: the chance that a positive has a higher score than a negative.

    Return NaN if all points are positive or none is.
    """
    n = int(positive.sum())
    if n in (0, len(positive)):
        return math.nan
    return float((ranks(score)[positive].sum() - n * (n + 1) / 2) / (n * (len(positive) - n)))


@dataclass(frozen=True)
class PairedTest:
    """Test of method ``b`` against method ``a`` on the scenes that both have."""

    scenes: int  # number of scenes compared
    wins: int  # scenes where b is lower
    losses: int
    ties: int
    mean_difference: float  # of b - a (negative: b is better)
    worst_ratio: float  # largest b / a over the scenes (NaN where a is 0 everywhere)
    # Rank-biserial correlation, -1 to 1: (ranks of b's losses - ranks of b's wins) / all ranks. Negative if b is
    # better, 0 if all are ties.
    rank_difference: float
    p_value: float  # two-sided Wilcoxon signed-rank test; ties are left out. NaN where no scene is compared


def compare(a: Sequence[float], b: Sequence[float]) -> PairedTest:
    """Compare two methods scene by scene; lower is better, pairs with a NaN are left out.

    The p value is exact for up to 50 differences, or up to 10 if some have the same size. For more it is a normal
    approximation. With fewer than two differences it is 1.
    """
    pairs = [(x, y) for x, y in zip(a, b, strict=True) if not (math.isnan(x) or math.isnan(y))]
    differences = np.array([y - x for x, y in pairs if y != x], np.float64)
    weights = ranks(np.abs(differences))
    losses = int(np.count_nonzero(differences > 0))
    p_value = 1.0 if pairs else math.nan
    if len(differences) > 1:
        from scipy.stats import PermutationMethod, wilcoxon  # takes a second to import

        tied = len(np.unique(np.abs(differences))) < len(differences)
        method: Any = "asymptotic" if tied or len(differences) > _MAX_EXACT else "exact"
        if tied and len(differences) <= _MAX_ENUMERATED:
            method = PermutationMethod(n_resamples=2**_MAX_ENUMERATED)
        p_value = float(wilcoxon(differences, method=method).pvalue)
    return PairedTest(
        scenes=len(pairs),
        wins=len(differences) - losses,
        losses=losses,
        ties=len(pairs) - len(differences),
        mean_difference=math.fsum(y - x for x, y in pairs) / len(pairs) if pairs else math.nan,
        worst_ratio=max((y / x for x, y in pairs if x > 0), default=math.nan),
        rank_difference=float((np.sign(differences) * weights).sum() / weights.sum()) if len(differences) else 0.0,
        p_value=p_value,
    )


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


def compare_all(by_scene: Mapping[str, Sequence[float]]) -> list[tuple[str, str, PairedTest, float]]:
    """Return run, other run, their test, and its p value corrected for all pairs after Holm."""
    tests = [(a, b, compare(by_scene[a], by_scene[b])) for a, b in itertools.combinations(by_scene, 2)]
    corrected = holm([test.p_value for *_, test in tests])
    return [(*pair, p) for pair, p in zip(tests, corrected, strict=True)]


class Ranking:
    """Runs, the best single figure first, and the test of every further one against the best.

    ``by_scene`` has one figure per scene: lower is better, NaN means none. ``ranks`` are the printed average ranks. The
    verdicts follow them, or the ranks of the tests if ``ranks`` is None.
    """

    def __init__(
        self, runs: Sequence[str], by_scene: Mapping[str, Sequence[float]], ranks: Mapping[str, float] | None = None
    ) -> None:
        best, *others = self.runs = tuple(runs)
        self.ranks = {run: rank for run, rank in (ranks or {}).items() if not math.isnan(rank)}
        self.tests = {run: compare(by_scene[best], by_scene[run]) for run in others}
        corrected = holm([test.p_value for test in self.tests.values()])
        self.p_values = dict(zip(others, corrected, strict=True))  # NaN without a common scene
        self.n_tests = sum(not math.isnan(p) for p in corrected)  # that the p values are corrected for

    def is_significant(self, run: str) -> bool:
        """Return whether a run differs significantly from the best."""
        return self.p_values[run] < SIGNIFICANT

    def word(self, run: str) -> str:
        """Return the verdict of the test on a run, in a word or two."""
        if run not in self.tests:
            return "best" if self.ranks.get(run, 0.0) <= min(self.ranks.values(), default=0.0) else "best figure"
        if not self.tests[run].scenes:
            return "no common scene"
        if smallest_p(self.tests[run].scenes, self.n_tests) >= SIGNIFICANT:
            return "too few scenes"
        if not self.is_significant(run):
            return "not significant"
        behind = self.ranks.get(run, 0.0) - self.ranks.get(self.runs[0], 0.0) or self.tests[run].rank_difference
        return "worse" if behind > 0 else "better in most"

    def verdict(self) -> str:
        """Return the results of the tests, in a sentence or two; empty for one run."""
        if not self.tests:
            return ""
        if not self.n_tests:
            return "No scene has a map of two runs: nothing can be tested."
        n_scenes = max(test.scenes for test in self.tests.values())
        lowest = smallest_p(n_scenes, self.n_tests)
        if lowest >= SIGNIFICANT:
            enough = next(n for n in range(2, 99) if smallest_p(n, self.n_tests) < SIGNIFICANT)
            what = f"With {n_scenes} scene{'s' * (n_scenes != 1)} no difference can be significant"
            return f"{what}: p is {lowest:.2g} or more; it takes {enough} scenes."
        words = {run: self.word(run) for run in self.tests}
        worse, better = ([run for run in words if words[run] == word] for word in ("worse", "better in most"))
        even = [run for run in words if run not in (*worse, *better)]
        if not worse and not better:
            return f"No significant difference (the smallest p is {min(self.p_values.values()):.2g})."
        sentences = []
        if worse:
            every = "every other run" if len(worse) == len(self.tests) > 1 else _names(worse)
            sentences.append(f"{self.runs[0]} is significantly better than {every}.")
        if better:
            sentences.append(f"In most scenes {_names(better)} is significantly better, though not in the mean.")
        if even:
            sentences.append(f"No significant difference to {_names(even)}.")
        return " ".join(sentences)


def _names(runs: Sequence[str]) -> str:
    if len(runs) > _MAX_NAMES:
        return f"{', '.join(runs[:_MAX_NAMES])} and {len(runs) - _MAX_NAMES} more"
    return " and ".join(filter(None, [", ".join(runs[:-1]), runs[-1]]))
