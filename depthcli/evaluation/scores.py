"""Scores: single numbers, each with all that it takes to read it rightly.

Benchmarks differ in what counts as an error, and above all in how they treat missing values. A :class:`Score`
therefore carries its region, denominator and density, and its :class:`Metric` the threshold and the convention.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

MISSING_IS_BAD = "missing counts as bad"
MISSING_APART = "missing counted apart (invalid)"
ESTIMATED_ONLY = "estimated pixels only"


@dataclass(frozen=True)
class Metric:
    """What a score is a value of; scores of equal metrics are averaged and compared.

    Attributes
    ----------
    name : ``bad``, ``D1``, ``avgerr`` ...
    unit : ``%``, ``px``, ``mm`` ... or empty
    threshold : in the protocol's unit, or None where the metric has none
    convention : how missing values are counted
    worst : value that a scene without a map counts as in a mean; None: the metric has no bound, and a mean over
        scenes of which one has no map is NaN
    larger_is_better : True where a score of 1 is better than one of 0
    label : heading of a table's column; made from metric and threshold where it is empty
    """

    name: str
    unit: str
    threshold: float | None = None
    convention: str = ""
    worst: float | None = None
    larger_is_better: bool = False
    label: str = field(default="", compare=False)

    @property
    def heading(self) -> str:
        """The label, or metric and threshold."""
        return self.label or (self.name if self.threshold is None else f"{self.name} {self.threshold:g}")

    @property
    def sign(self) -> int:
        """Factor that makes lower values the better ones."""
        return -1 if self.larger_is_better else 1

    @property
    def heading_with_unit(self) -> str:
        """The heading, with the unit behind a comma where there is one."""
        return f"{self.heading}, {self.unit}" if self.unit else self.heading


Key = tuple[Metric, str]
"""A metric and the region that it is taken in."""


@dataclass(frozen=True)
class Score:
    """The value of one metric in one region.

    Attributes
    ----------
    metric, region : what the value is of, and the name of the region
    value : NaN where the region has no pixel to take it over
    pixels : denominator: number of pixels (points, voxels) that the value is taken over
    density : percentage of the region's pixels with known truth where the map has a value; NaN for an empty region
    wrong : number of wrong pixels, or None where the metric counts none
    region_pixels : number of the region's pixels with known truth, by which densities of several scenes are pooled
    """

    metric: Metric
    region: str
    value: float
    pixels: int
    density: float
    wrong: int | None = None
    region_pixels: int = 0

    @property
    def key(self) -> Key:
        """Metric and region."""
        return self.metric, self.region

    def row(self) -> dict[str, Any]:
        """Return all fields as plain values, the region as ``mask``."""
        m = self.metric
        return {
            "metric": m.name, "mask": self.region, "threshold": m.threshold, "value": self.value, "unit": m.unit,
            "wrong": self.wrong, "pixels": self.pixels, "density": self.density, "convention": m.convention,
        }  # fmt: skip


@dataclass(frozen=True)
class Tally:
    """The errors of one region, from which scores are made.

    Attributes
    ----------
    region : its name
    error : (N,) float, absolute errors of its pixels with known truth, NaN = no estimate
    """

    region: str
    error: NDArray[np.floating[Any]]

    @cached_property
    def valid(self) -> NDArray[np.floating[Any]]:
        """(M,) errors of the estimated pixels."""
        valid: NDArray[np.floating[Any]] = self.error[~np.isnan(self.error)]
        return valid

    @cached_property
    def density(self) -> float:
        """Percentage of the pixels that have an estimate."""
        return percent(int(np.count_nonzero(~np.isnan(self.error))), self.error.size)

    def rate(self, metric: Metric, wrong: NDArray[np.bool_]) -> Score:
        """Return the percentage of True in ``wrong``, an array of all or some of the region's pixels."""
        n_wrong = int(np.count_nonzero(wrong))
        share = percent(n_wrong, wrong.size)
        return Score(metric, self.region, share, wrong.size, self.density, n_wrong, self.error.size)

    def number(self, metric: Metric, value: float, pixels: int) -> Score:
        """Return the score of a metric that counts no wrong pixels."""
        return Score(metric, self.region, value, pixels, self.density, region_pixels=self.error.size)

    def means(self) -> list[Score]:
        """Return ``avgerr`` and ``rms`` in pixels of disparity, over the estimated pixels."""
        error = self.valid.astype(np.float64)
        mean, square = (float(v.mean()) if v.size else math.nan for v in (error, error * error))
        return [
            self.number(Metric("avgerr", "px", convention=ESTIMATED_ONLY), mean, error.size),
            self.number(Metric("rms", "px", convention=ESTIMATED_ONLY), math.sqrt(square), error.size),
        ]


def percent(part: int, whole: int) -> float:
    """Return ``part`` as a percentage of ``whole``; NaN where that is 0."""
    return 100.0 * part / whole if whole else math.nan


def float_sum(values: NDArray[np.float32]) -> float:
    """Return the sum in single precision, one value added after the other, as the benchmarks' C programs do."""
    return float(np.cumsum(values, dtype=np.float32)[-1]) if values.size else 0.0


def find_score(
    scores: Sequence[Score], metric: str, region: str, threshold: float | None = None, convention: str | None = None
) -> Score:
    """Return the one score of that metric, region and, where they are given, threshold and convention.

    Raises
    ------
    KeyError
        No score fits, or several do.
    """
    fitting = [
        s
        for s in scores
        if (s.metric.name, s.region) == (metric, region)
        and threshold in (None, s.metric.threshold)
        and convention in (None, s.metric.convention)
    ]
    if len(fitting) != 1:
        what = f"{metric}, region {region}, threshold {threshold}, convention {convention}"
        raise KeyError(f"{len(fitting)} scores for {what}" if fitting else f"no score {what}")
    return fitting[0]


def pooled(
    pool: Callable[[Sequence[Score], Sequence[float]], Score], scored: Iterable[tuple[Sequence[Score], float]]
) -> list[Score]:
    """Return one score for every metric and region out of (scores, weight) of several scenes."""
    groups: dict[Key, list[tuple[Score, float]]] = {}
    for scores, weight in scored:
        for score in scores:
            groups.setdefault(score.key, []).append((score, weight))
    return [pool(*zip(*group, strict=True)) for group in groups.values()]


def mean_of_scenes(scores: Sequence[Score], weights: Sequence[float]) -> Score:
    """Return the weighted mean over the scenes.

    Empty regions are left out. A region in which a map has no value counts as the metric's worst; if the metric has no
    bound, the mean is NaN.
    """
    pairs = [(s, w) for s, w in zip(scores, weights, strict=True) if not math.isnan(s.density)]
    metric, total = scores[0].metric, math.fsum(w for _, w in pairs)
    worst = math.nan if metric.worst is None else metric.worst
    value, density = math.nan, math.nan
    if total:
        value = math.fsum(w * (worst if math.isnan(s.value) else s.value) for s, w in pairs) / total
        density = math.fsum(w * s.density for s, w in pairs) / total
    return Score(metric, scores[0].region, value, sum(s.pixels for s, _ in pairs), density)


def in_order(regions: Iterable[str], order: Sequence[str]) -> list[str]:
    """Return names of regions in the order of a protocol's ``region_order``, then all others by name."""
    present = set(regions)
    return [name for name in order if name in present] + sorted(present - set(order))
