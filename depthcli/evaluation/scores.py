"""Scores: one number each, and everything that it stands on.

Benchmarks differ in what counts as an error, and above all in what a missing value counts as. A :class:`Score`
therefore carries its mask, denominator and density, and its :class:`Measure` the threshold and the convention.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

MISSING_IS_BAD = "missing counts as bad"
MISSING_APART = "missing counted apart (invalid)"
ESTIMATED_ONLY = "estimated pixels only"


@dataclass(frozen=True)
class Measure:
    """What a score measures; equal measures are averaged and compared.

    Attributes
    ----------
    metric : ``bad``, ``D1``, ``avgerr`` ...
    unit : ``%``, ``px``, ``mm`` ... or empty
    threshold : in the protocol's unit, or None where the measure has none
    convention : what a missing value counts as
    worst : what an scene without a map counts as in a mean; None: the measure has no bound, and a mean over scenes
        that lack a map is no number
    larger_is_better : a score of 1 beats one of 0
    label : heading of a table's column; made from metric and threshold where it is empty
    """

    metric: str
    unit: str
    threshold: float | None = None
    convention: str = ""
    worst: float | None = None
    larger_is_better: bool = False
    label: str = field(default="", compare=False)

    @property
    def heading(self) -> str:
        """The label, or metric and threshold."""
        return self.label or (self.metric if self.threshold is None else f"{self.metric} {self.threshold:g}")


@dataclass(frozen=True)
class Score:
    """One number.

    Attributes
    ----------
    measure, mask : what was measured, and the region it was taken in
    value : NaN where there is no pixel to take it over
    pixels : denominator (or points, voxels)
    density : percent of the region's pixels with known truth that the map answers; NaN for an empty region
    wrong : number of wrong pixels, or None where the measure counts none
    """

    measure: Measure
    mask: str
    value: float
    pixels: int
    density: float
    wrong: int | None = None

    def row(self) -> dict[str, Any]:
        """All of it as plain values."""
        m = self.measure
        return {
            "metric": m.metric, "mask": self.mask, "threshold": m.threshold, "value": self.value, "unit": m.unit,
            "wrong": self.wrong, "pixels": self.pixels, "density": self.density, "convention": m.convention,
        }  # fmt: skip


@dataclass(frozen=True)
class Tally:
    """The errors of one region, from which scores are made.

    Attributes
    ----------
    mask : name of the region
    error : (N,) float, absolute errors of its pixels with known truth, NaN = no estimate
    """

    mask: str
    error: NDArray[np.floating[Any]]

    @cached_property
    def valid(self) -> NDArray[np.floating[Any]]:
        """The errors of the estimated pixels."""
        valid: NDArray[np.floating[Any]] = self.error[~np.isnan(self.error)]
        return valid

    @cached_property
    def density(self) -> float:
        """Percent of the pixels that have an estimate."""
        return percent(int(np.count_nonzero(~np.isnan(self.error))), self.error.size)

    def rate(self, measure: Measure, wrong: NDArray[np.bool_]) -> Score:
        """Percent of the pixels in ``wrong``, which may be fewer than the region's."""
        count = int(np.count_nonzero(wrong))
        return Score(measure, self.mask, percent(count, wrong.size), wrong.size, self.density, count)

    def number(self, measure: Measure, value: float, pixels: int) -> Score:
        """A value that counts no pixels."""
        return Score(measure, self.mask, value, pixels, self.density)

    def means(self, unit: str = "px", convention: str = ESTIMATED_ONLY) -> list[Score]:
        """``avgerr`` and ``rms`` over the estimated pixels."""
        error = self.valid.astype(np.float64)
        mean, square = (float(v.mean()) if v.size else math.nan for v in (error, error * error))
        return [
            self.number(Measure("avgerr", unit, convention=convention), mean, error.size),
            self.number(Measure("rms", unit, convention=convention), math.sqrt(square), error.size),
        ]


def bad_rate(
    estimate: NDArray[np.floating[Any]],
    truth: NDArray[np.floating[Any]],
    region: NDArray[np.bool_],
    threshold: float = 1.0,
) -> float:
    """Percent of a region's pixels whose value is off by more than ``threshold`` or missing.

    Parameters
    ----------
    estimate, truth : same shape and unit, NaN = none; pixels without known truth do not count
    region : bool, True = evaluate
    """
    inside = region & ~np.isnan(truth)
    return percent(int(np.count_nonzero(~(np.abs(estimate[inside] - truth[inside]) <= threshold))), int(inside.sum()))


def percent(part: int, whole: int) -> float:
    """NaN of nothing."""
    return 100.0 * part / whole if whole else math.nan


def float_sum(values: NDArray[np.float32]) -> float:
    """Sum as a C program's ``float`` accumulator gives it, one value after the other: what the benchmarks print."""
    return float(np.cumsum(values, dtype=np.float32)[-1]) if values.size else 0.0


def find_score(
    scores: Sequence[Score], metric: str, mask: str, threshold: float | None = None, convention: str | None = None
) -> Score:
    """The one score of that name.

    Raises
    ------
    KeyError
        There is none, or more than one fits.
    """
    fitting = [
        s
        for s in scores
        if (s.measure.metric, s.mask) == (metric, mask)
        and threshold in (None, s.measure.threshold)
        and convention in (None, s.measure.convention)
    ]
    if len(fitting) != 1:
        what = f"{metric}, mask {mask}, threshold {threshold}, convention {convention}"
        raise KeyError(f"{len(fitting)} scores for {what}" if fitting else f"no score {what}")
    return fitting[0]
