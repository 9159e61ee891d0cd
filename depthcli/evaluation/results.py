"""The scores of one run on one scene, and the rows in which every number of an evaluation is written."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from depthcli.evaluation.curves import ConfidenceCurve, HiddenPixels
from depthcli.evaluation.scores import Key, Metric, Score, find_score
from depthcli.io.formats.files import short_path

MEAN, COMMON_MEAN = "*mean", "*common mean"
"""Scenes of the records that hold means: over all scenes, and over those of which every run has a map."""

COLUMNS = (
    "run", "data_set", "scene", "protocol", "metric", "threshold", "mask", "value", "unit", "wrong", "pixels",
    "density", "convention", "map", "note",
)  # fmt: skip
"""Columns of ``scores.csv``; ``mask`` is the region, by the name that the column has always had."""


def record(result: Mapping[str, str], score: Score | None, source: str = "", note: str = "") -> dict[str, Any]:
    """Return one number of an evaluation as a row of ``scores.csv``: ``COLUMNS``, empty if there is nothing to write.

    Parameters
    ----------
    result : ``run``, ``data_set``, ``scene`` (or ``MEAN``, ``COMMON_MEAN``) and ``protocol``
    score : metric, region, value and denominator; None: the note says why there is no number
    source : path of the map inside its run folder
    note : what has to be known beside the number
    """
    cells = {"metric": "failed"} if score is None else score.row()
    if result["scene"] == COMMON_MEAN:
        cells |= {"density": None, "pixels": None, "wrong": None}
    cells |= {**result, "map": source, "note": note}
    found = {name: cells.get(name) for name in COLUMNS}
    return {k: "" if v is None or (isinstance(v, float) and not math.isfinite(v)) else v for k, v in found.items()}


@dataclass(frozen=True)
class MapResult:
    """One map of one run against the truth of one scene, or the reason why there is none.

    Attributes
    ----------
    run, scene, data_set, protocol : where the numbers belong
    source : the map's path inside its run folder, or empty
    scores : where the map is missing, the worst of every metric (``missing_scores``); empty where there is no
        usable truth
    dense : scores of the headline's metric at many thresholds, for plots (``Protocol.threshold_curve``)
    curves : sparsification curves of the confidence maps that lie beside the map
    hidden : how well the map's status says what the right view does not see; None where that is not known
    seconds : run time by the run's report, or NaN
    size : number of pixels (or voxels) of the scene, with known truth or without; 0 where there is no map
    n_disparities : number of disparities that the run searched, 0 where its report does not say
    warning : what looks wrong with the map, or empty
    error : why there is no map to score, or empty
    pooling_data : what the protocol needs beside the scores to pool several scenes, or None
    """

    run: str
    scene: str
    data_set: str
    protocol: str
    source: str = ""
    scores: tuple[Score, ...] = ()
    dense: tuple[Score, ...] = ()
    curves: tuple[ConfidenceCurve, ...] = ()
    hidden: HiddenPixels | None = None
    seconds: float = math.nan
    size: int = 0
    n_disparities: int = 0
    warning: str = ""
    error: str = ""
    pooling_data: Any = field(default=None, repr=False, compare=False)

    def value(self, metric: str, region: str, threshold: float | None = None, convention: str | None = None) -> float:
        """Return one number of this result; KeyError where no score fits, or several do."""
        return find_score(self.scores, metric, region, threshold, convention).value

    @cached_property
    def by_key(self) -> dict[Key, Score]:
        """(metric, region) -> score."""
        return {score.key: score for score in self.scores}

    @property
    def picture(self) -> str:
        """Path of its error picture in the output folder."""
        return short_path(f"errors/{self.run}/{self.scene}.png")

    @property
    def plots(self) -> dict[tuple[str, str], str]:
        """(region, kind of curve) -> path of the plot in the output folder."""
        start = f"curves/{self.run}/{self.scene}"
        return {(c.region, c.of): short_path(f"{start}_{c.region}_{c.of}.svg") for c in self.curves}

    @property
    def table_of_points(self) -> str:
        """Path of the table of its points in the output folder, where the protocol has such a table."""
        return short_path(f"points/{self.run}/{self.scene}.csv")

    def records(self) -> list[dict[str, Any]]:
        """Return the rows of ``scores.csv``: scores, areas of the curves (metric ``AREA:CONFIDENCE:KIND``), failure."""
        where = {"run": self.run, "data_set": self.data_set, "scene": self.scene, "protocol": self.protocol}
        note = f"missing, counted as wholly wrong: {self.error}" if self.error else self.warning
        made = [record(where, score, self.source, note) for score in self.scores]
        others = [
            Score(Metric(f"{area}:{c.confidence}:{c.of}", ""), c.region, value, c.line.pixels, math.nan)
            for c in self.curves
            for area, value in c.areas.items()
            if area != "ece" or c.reliability is not None
        ]
        if self.hidden is not None:
            others += [
                Score(Metric(f"hidden {name}", "%"), "all", value, self.hidden.pixels, math.nan)
                for name, value in self.hidden.shares().items()
            ]
        made += [record(where, score, self.source) for score in others]
        return [*made, record(where, None, self.source, self.error)] if self.error else made

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain values."""
        return {
            "run": self.run, "scene": self.scene, "data_set": self.data_set, "protocol": self.protocol,
            "map": self.source, "seconds": self.seconds, "missing": bool(self.error),
            "warning": self.warning or None, "error": self.error or None,
            "scores": [score.row() for score in self.scores],
            "confidence": [
                {
                    "measure": c.confidence, "mask": c.region, "of": c.of, **vars(c.line), **c.areas,
                    "reliability": None if c.reliability is None else vars(c.reliability),
                }
                for c in self.curves
            ],
            "hidden": None if self.hidden is None else {**vars(self.hidden), **self.hidden.shares()},
        }  # fmt: skip
