"""Scores: single numbers with their conventions, and the results of one map.

Benchmarks define errors in different ways, and most of all differ in missing values. A :class:`Score` therefore has
its region, denominator and density, and its :class:`Metric` the threshold and the convention.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.evaluation.curves import ConfidenceCurve, HiddenPixels
from depthcli.io.formats.files import short_path

MISSING_IS_BAD = "missing counts as bad"
MISSING_APART = "missing counted apart (invalid)"
ESTIMATED_ONLY = "estimated pixels only"

MEAN, COMMON_MEAN, _COMMON = "*mean", "*common mean", "*common "
"""Scene names of means: over all scenes, and over the scenes for which every run has a map."""


@dataclass(frozen=True)
class Metric:
    """The quantity of a score; scores of equal metrics are averaged and compared."""

    name: str  # ``bad``, ``D1``, ``avgerr`` ...
    unit: str  # ``%``, ``px``, ``mm`` ... or empty
    threshold: float | None = None  # in the protocol's unit, or None where the metric has none
    convention: str = ""  # how missing values are counted
    worst: float | None = None  # value of a scene without a map in a mean; None: it has no bound, the mean is NaN
    larger_is_better: bool = False
    label: str = field(default="", compare=False)  # heading of a column; made from metric and threshold where empty

    @property
    def heading(self) -> str:
        """The label, or metric and threshold."""
        return self.label or (self.name if self.threshold is None else f"{self.name} {self.threshold:g}")

    @property
    def heading_with_unit(self) -> str:
        """The heading, with its unit, if any, after a comma."""
        return f"{self.heading}, {self.unit}" if self.unit else self.heading

    @property
    def sign(self) -> int:
        """Factor that makes lower values better."""
        return -1 if self.larger_is_better else 1


Key = tuple[Metric, str]
"""A metric and the region that it is taken in."""


@dataclass(frozen=True)
class Score:
    """The value of one metric in one region."""

    metric: Metric
    region: str
    value: float  # NaN where the region has no pixel to take it over
    pixels: int  # denominator: number of pixels (points, voxels) that the value is taken over
    density: float  # percentage of the region's known pixels where the map has a value; NaN for an empty region
    wrong: int | None = None  # number of incorrect pixels, or None if the metric counts none
    region_pixels: int = 0  # number of the region's pixels with known truth, which weighs densities

    @property
    def key(self) -> Key:
        """Metric and region."""
        return self.metric, self.region

    def row(self) -> dict[str, Any]:
        """Return all fields as plain values, the region as ``mask``."""
        m = self.metric
        return {"metric": m.name, "mask": self.region, "threshold": m.threshold, "value": self.value, "unit": m.unit,
                "wrong": self.wrong, "pixels": self.pixels, "density": self.density,
                "convention": m.convention}  # fmt: skip


@dataclass(frozen=True)
class Tally:
    """The errors of one region: (N,) float, absolute, of its pixels with known truth; NaN = no estimate."""

    region: str
    error: NDArray[np.floating[Any]]

    @cached_property
    def valid(self) -> NDArray[np.floating[Any]]:
        """(M,) errors of the estimated pixels."""
        valid: NDArray[np.floating[Any]] = self.error[~np.isnan(self.error)]
        return valid

    @property
    def density(self) -> float:
        """Percentage of the pixels that have an estimate."""
        return percent(self.valid.size, self.error.size)

    def rate(self, metric: Metric, wrong: NDArray[np.bool_]) -> Score:
        """Return the percentage of True in ``wrong``, an array of all or some of the region's pixels."""
        n_wrong = int(np.count_nonzero(wrong))
        share = percent(n_wrong, wrong.size)
        return Score(metric, self.region, share, wrong.size, self.density, n_wrong, self.error.size)

    def number(self, metric: Metric, value: float, pixels: int) -> Score:
        """Return the score of a metric that counts no incorrect pixels."""
        return Score(metric, self.region, value, pixels, self.density, region_pixels=self.error.size)

    def means(self) -> list[Score]:
        """Return ``avgerr`` and ``rms`` in pixels of disparity, over the estimated pixels."""
        error = self.valid.astype(np.float64)
        mean, rms = (float(error.mean()), math.sqrt((error * error).mean())) if error.size else (math.nan, math.nan)
        return [
            self.number(Metric("avgerr", "px", convention=ESTIMATED_ONLY), mean, error.size),
            self.number(Metric("rms", "px", convention=ESTIMATED_ONLY), rms, error.size),
        ]

    def quantiles(self, place: Callable[[int, int], int]) -> list[Score]:
        """Return ``A50`` to ``A99``, px: ``place`` has the index of the q % quantile among n sorted errors."""
        ordered, n = np.sort(self.valid), self.valid.size
        return [
            self.number(
                Metric(f"A{q}", "px", convention=ESTIMATED_ONLY), float(ordered[place(q, n)]) if n else math.nan, n
            )
            for q in (50, 90, 95, 99)  # as printed by the programs of ETH3D and Middlebury v3
        ]


def percent(part: int, whole: int) -> float:
    """Return ``part`` as a percentage of ``whole``; NaN if ``whole`` is 0."""
    return 100.0 * part / whole if whole else math.nan


def float_sum(values: NDArray[np.float32]) -> float:
    """Return the sum in single precision, one value added after the other, as the benchmarks' C programs do."""
    return float(np.cumsum(values, dtype=np.float32)[-1]) if values.size else 0.0


def find_score(
    scores: Sequence[Score], metric: str, region: str, threshold: float | None = None, convention: str | None = None
) -> Score:
    """Return the score of a metric, region and, if given, threshold and convention; KeyError unless one matches."""
    fitting = [
        s
        for s in scores
        if (s.metric.name, s.region) == (metric, region)
        and threshold in (None, s.metric.threshold)
        and convention in (None, s.metric.convention)
    ]
    if len(fitting) != 1:
        raise KeyError(f"{len(fitting)} scores {metric}, region {region}, threshold {threshold}, {convention}")
    return fitting[0]


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


_COLUMNS = "run data_set scene protocol metric threshold mask value unit wrong pixels density convention map note"


def record(where: Mapping[str, str], score: Score | None, source: str = "", note: str = "") -> dict[str, Any]:
    """Return one number of an evaluation as a row of ``scores.csv``; cells without a value are empty.

    ``where`` has ``run``, ``data_set``, ``scene`` (or a mean) and ``protocol``, ``source`` is the map's path inside the
    run folder. Without a score, the note has the reason.
    """
    cells: dict[str, Any] = {"metric": "failed"} if score is None else score.row()
    if where["scene"].startswith(_COMMON):
        cells |= {"density": None, "pixels": None, "wrong": None}
    row: dict[str, Any] = dict.fromkeys(_COLUMNS.split(), "")
    for name, value in {**cells, **where, "map": source, "note": note}.items():
        if value is not None and not (isinstance(value, float) and not math.isfinite(value)):
            row[name] = value
    return row


@dataclass(frozen=True)
class MapResult:
    """The result of one run on one scene, or the reason why there is none."""

    run: str
    scene: str
    data_set: str
    protocol: str
    source: str = ""  # path of the map inside its run folder
    scores: tuple[Score, ...] = ()  # the worst of every metric if the map is missing; empty without a usable truth
    dense: tuple[Score, ...] = ()  # of the headline's metric at many thresholds, for plots
    curves: tuple[ConfidenceCurve, ...] = ()  # of the map's confidence maps
    bounds: tuple[Score, ...] = ()  # of the bound of its errors, by region; empty: it has none
    hidden: HiddenPixels | None = None  # how well the map's status marks pixels that the right view does not see
    seconds: float = math.nan  # by the run's report
    size: int = 0  # number of pixels (or voxels) of the scene, with known truth or without; 0 without a map
    n_disparities: int = 0  # that the run searched; 0 if its report has no number
    warning: str = ""  # what looks wrong with the map
    run_warnings: tuple[str, ...] = ()  # of the run's own report
    error: str = ""  # why there is no map to score
    pooling_data: Any = field(default=None, repr=False, compare=False)  # data by which the protocol pools scenes

    @property
    def times(self) -> dict[str, float]:
        """Seconds per scene, per megapixel, and per 10^9 pixels x disparities; NaN if unknown."""
        work = {"seconds": (1.0, 1), "s/MP": (1e6, self.size), "s/GD": (1e9, self.size * self.n_disparities)}
        return {heading: unit * self.seconds / n if n else math.nan for heading, (unit, n) in work.items()}

    @property
    def picture(self) -> str:
        """Path of its error picture in the output folder."""
        return short_path(f"errors/{self.run}/{self.scene}.png")

    @property
    def bound_picture(self) -> str:
        """Path of the picture of its bound in the output folder."""
        return short_path(f"bounds/{self.run}/{self.scene}.png")

    @property
    def plots(self) -> dict[tuple[str, str], str]:
        """(region, kind of curve) -> path of the plot in the output folder."""
        start = f"curves/{self.run}/{self.scene}"
        return {(c.region, c.of): short_path(f"{start}_{c.region}_{c.of}.svg") for c in self.curves}

    def records(self) -> list[dict[str, Any]]:
        """Return the rows of ``scores.csv``: scores, areas of the curves (metric ``AREA:CONFIDENCE:KIND``), failure."""
        where = {"run": self.run, "data_set": self.data_set, "scene": self.scene, "protocol": self.protocol}
        note = f"missing, all pixels count as incorrect: {self.error}" if self.error else self.warning
        rows = [record(where, score, self.source, note) for score in (*self.scores, *self.bounds)]
        for c in self.curves:
            for area, value in c.areas.items():
                if area != "ece" or c.reliability is not None:
                    metric = Metric(f"{area}:{c.confidence}:{c.of}", "")
                    rows.append(record(where, Score(metric, c.region, value, c.line.pixels, math.nan), self.source))
        if self.hidden is not None:
            for name, value in self.hidden.shares().items():
                score = Score(Metric(f"hidden {name}", "%"), "all", value, self.hidden.pixels, math.nan)
                rows.append(record(where, score, self.source))
        return [*rows, record(where, None, self.source, self.error)] if self.error else rows

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain values."""
        confidence = [
            {"measure": c.confidence, "mask": c.region, "of": c.of, **vars(c.line), **c.areas,
             "reliability": None if c.reliability is None else vars(c.reliability)}
            for c in self.curves
        ]  # fmt: skip
        return {"run": self.run, "scene": self.scene, "data_set": self.data_set, "protocol": self.protocol,
                "map": self.source, "seconds": self.seconds, "missing": bool(self.error),
                "warning": self.warning or None, "error": self.error or None,
                "scores": [score.row() for score in self.scores], "confidence": confidence,
                "bounds": [score.row() for score in self.bounds],
                "hidden": None if self.hidden is None else {**self.hidden._asdict(), **self.hidden.shares()},
        }  # fmt: skip


def difference(results: Iterable[MapResult], headline: Metric, several: bool) -> float:
    """Return the difference of the runs' headlines on one scene, in the main region.

    For ``several`` runs, return the largest headline minus the smallest. For a single run, return its headline, with
    the sign that makes larger values worse. Return -inf if there is no number.
    """
    values = []
    for result in results:
        headlines = [score.value for score in result.scores if score.metric == headline and not result.error]
        values += [headline.sign * value for value in headlines[:1] if not math.isnan(value)]
    if not values:
        return -math.inf
    return max(values) - min(values) if several else values[0]
