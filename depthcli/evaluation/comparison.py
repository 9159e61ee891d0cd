"""Runs compared: the results of a data set under one protocol, their means and ranks, and the whole evaluation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from depthcli.core.errors import InputError
from depthcli.core.flags import Flags
from depthcli.core.text import summarized
from depthcli.evaluation.protocols import AnyProtocol
from depthcli.evaluation.ranking import Ranking
from depthcli.evaluation.results import COMMON_MEAN, MEAN, MapResult, Record
from depthcli.evaluation.scores import Key, Score
from depthcli.evaluation.statistics import average_ranks


@dataclass(frozen=True)
class Section:
    """The results of one data set under one protocol; every run has a result for every scene.

    A run's mean over **all** scenes counts a scene without a map as wholly wrong. The mean over the **common** scenes,
    of which every run has a map, compares what was computed. Ranks are taken over the common scenes alone. A mean in
    one region is over those of the scenes that have truth in it (``scenes_with``).
    """

    data_set: str
    protocol: AnyProtocol
    runs: tuple[str, ...]
    results: tuple[MapResult, ...]

    @cached_property
    def scenes(self) -> list[str]:
        """Names of all scenes, in the order of the results."""
        return list(dict.fromkeys(result.scene for result in self.results))

    @cached_property
    def common(self) -> frozenset[str]:
        """Names of the scenes of which every run has a map."""
        return frozenset(self.scenes) - {result.scene for result in self.results if result.error}

    @cached_property
    def regions(self) -> list[str]:
        """Names of the regions, in the protocol's order; the first is the main region."""
        return self.protocol.ordered(score.region for result in self.results for score in result.scores)

    @cached_property
    def keys(self) -> list[Key]:
        """All pairs of metric and region that have a score."""
        return list(dict.fromkeys(score.key for result in self.results for score in result.scores))

    @property
    def incomplete(self) -> bool:
        """True where some run has no map of some scene."""
        return len(self.common) < len(self.scenes)

    @cached_property
    def _scenes_by_region(self) -> dict[str, frozenset[str]]:
        known = [(s.region, r.scene) for r in self.results for s in r.scores if not math.isnan(s.density)]
        return {region: frozenset(scene for name, scene in known if name == region) for region in self.regions}

    def scenes_with(self, region: str, common: bool = False) -> frozenset[str]:
        """Return the names of the scenes, or common scenes, whose truth is known somewhere in a region."""
        found = self._scenes_by_region[region]
        return found & self.common if common else found

    @cached_property
    def figure_regions(self) -> list[str]:
        """Names of the regions that the single figure of a run is taken over.

        They are the protocol's, without those that some scene lacks, so that every scene counts alike; or else the
        main region.
        """
        named = self.protocol.figure_regions(self.regions)
        return [name for name in named if len(self.scenes_with(name)) == len(self.scenes)] or named[:1]

    def results_of(self, run: str, common: bool = False) -> list[MapResult]:
        """Return one run's results of all scenes, or of the common ones."""
        return [r for r in self.results if r.run == run and (not common or r.scene in self.common)]

    def n_missing(self, run: str, region: str | None = None) -> int:
        """Return the number of scenes, or of those with truth in a region, of which a run has no map."""
        missing = {result.scene for result in self.results_of(run) if result.error}
        return len(missing if region is None else missing & self.scenes_with(region))

    @cached_property
    def _means(self) -> dict[tuple[str, bool], dict[Key, Score]]:
        """(run, over the common scenes alone) -> (metric, region) -> mean."""

        def means(run: str, common: bool) -> dict[Key, Score]:
            return {score.key: score for score in self.protocol.mean(self.results_of(run, common))}

        made = {(run, False): means(run, False) for run in self.runs}
        return made | {(run, True): means(run, True) if self.incomplete else made[run, False] for run in self.runs}

    def mean(self, run: str, key: Key, common: bool = False) -> Score:
        """Return a run's mean over all scenes or the common ones; NaN where there is none."""
        return self._means[run, common].get(key) or Score(*key, math.nan, 0, math.nan)

    def overall(self, run: str, common: bool = False) -> Score:
        """Return the single figure of a run over all scenes or the common ones; NaN where there is none.

        It is the headline over ``figure_regions``.
        """
        keys = [(self.protocol.headline, region) for region in self.figure_regions]
        if len(keys) == 1:  # the mean of that region, which a protocol may compute in its own way
            return self.mean(run, keys[0], common)
        pairs = [
            (result.by_key[key], self.protocol.weight(result.scene))
            for result in self.results_of(run, common)
            for key in keys
            if key in result.by_key
        ]
        return self.protocol.pool(*zip(*pairs, strict=True)) if pairs else self.mean(run, keys[0], common)

    def records(self) -> list[Record]:
        """Return the means of every run, metric and region, over all scenes (``MEAN``) and common ones."""
        made = []
        for run in self.runs:
            for key in self._means[run, False]:
                n_scenes, n_common = (len(self.scenes_with(key[1], common)) for common in (False, True))
                n_missing = self.n_missing(run, key[1])
                missing = f", {n_missing} missing ones counted as wholly wrong" if n_missing else ""
                note = f"over {n_scenes} scenes{missing}"
                both = ((MEAN, False, note), (COMMON_MEAN, True, f"over the {n_common} scenes that all runs have"))
                for scene, common, about in both:
                    score = self.mean(run, key, common)
                    made.append(Record(run, self.data_set, scene, self.protocol.name, score, note=about))
        return made

    def rows(self) -> list[dict[str, Any]]:
        """Return the means of every run, metric and region as plain values."""
        return [
            self._row(run, score, self.mean(run, key, common=True))
            for run in self.runs
            for key, score in self._means[run, False].items()
        ]

    def overall_rows(self) -> list[dict[str, Any]]:
        """Return the single figure of every run as plain values."""
        regions = "+".join(self.figure_regions)
        return [
            self._row(run, self.overall(run), self.overall(run, common=True)) | {"mask": regions} for run in self.runs
        ]

    def _row(self, run: str, score: Score, common: Score) -> dict[str, Any]:
        return {
            "run": run, "data_set": self.data_set, "protocol": self.protocol.name, **score.row(),
            "scenes": len(self.scenes_with(score.region)), "missing": self.n_missing(run, score.region),
            "common": len(self.scenes_with(score.region, common=True)), "value_common": common.value,
        }  # fmt: skip

    def threshold_curve(self, run: str) -> list[Score]:
        """Return the means over all scenes of one metric at many thresholds."""
        return self.protocol.pooled((r.dense, r.scene) for r in self.results_of(run))

    def by_scene(self, run: str) -> list[float]:
        """Return one run's single figure of every scene, lower is better: signed; NaN where there is no map."""
        keys = [(self.protocol.headline, region) for region in self.figure_regions]
        made = []
        for result in self.results_of(run):
            values = [result.by_key[key].value for key in keys if key in result.by_key and not result.error]
            made.append(keys[0][0].sign * math.fsum(values) / len(keys) if len(values) == len(keys) else math.nan)
        return made

    @cached_property
    def ranking(self) -> Ranking:
        """The runs from the best single figure to the worst; those without one last, by that of the common scenes."""
        sign = self.protocol.headline.sign
        both = {run: [sign * self.overall(run, common).value for common in (False, True)] for run in self.runs}
        order = sorted(self.runs, key=lambda run: [(math.isnan(v), 0.0 if math.isnan(v) else v) for v in both[run]])
        return Ranking.of(order, {run: self.by_scene(run) for run in self.runs})

    def average_rank(self, keys: Sequence[Key]) -> dict[str, float]:
        """Return run -> mean rank over the common scenes and (metric, region) pairs; equal values share a rank."""
        results = [self.results_of(run, common=True) for run in self.runs]
        grid = [[key[0].sign * r.by_key[key].value for r in row for key in keys if key in r.by_key] for row in results]
        ranks = average_ranks(np.array(grid, np.float64).reshape(len(self.runs), -1))
        return {run: float(rank) for run, rank in zip(self.runs, ranks, strict=True)}

    def threshold_rows(self) -> list[dict[str, Any]]:
        """Return the lines of the plot against the threshold, one for every run that has one, as plain values."""
        made = []
        for run in self.runs:
            if scores := self.threshold_curve(run):
                m = scores[0].metric
                made.append({
                    "run": run, "data_set": self.data_set, "protocol": self.protocol.name,
                    "metric": m.name, "mask": scores[0].region, "unit": m.unit, "convention": m.convention,
                    "thresholds": [s.metric.threshold for s in scores], "values": [s.value for s in scores],
                })  # fmt: skip
        return made


@dataclass(frozen=True)
class EvaluationReport:
    """All results of an evaluation, in the order of the scenes, then of the runs.

    Attributes
    ----------
    runs : names of the runs
    results : one for every scene and run
    protocols : name -> protocol, of all that the results name
    truth : folder or file of the ground truth, as people may see it
    hints : what was assumed of runs and scenes, and what looks wrong with the way they are scored, one line each
    plugins : package -> version, of the plug-ins that found, read and scored the scenes
    flags : what a person should look at, by conditions on columns
    """

    runs: tuple[str, ...]
    results: tuple[MapResult, ...]
    protocols: dict[str, AnyProtocol]
    truth: str
    hints: tuple[str, ...] = ()
    plugins: dict[str, str] = field(default_factory=dict)
    flags: Flags = field(default_factory=Flags)

    @property
    def failed(self) -> list[MapResult]:
        """Results without a usable map or truth."""
        return [result for result in self.results if result.error]

    @property
    def warnings(self) -> list[str]:
        """What looks wrong with the scenes and maps, one line each."""
        return [*self.hints, *(f"{r.run}: {r.scene}: {r.warning}" for r in self.results if r.warning)]

    @property
    def warning_lines(self) -> list[str]:
        """``warnings``, where those of a run that differ in numbers and scenes alone are one line."""
        by_run: dict[str, list[tuple[str, str]]] = {}
        for result in self.results:
            if result.warning:
                by_run.setdefault(result.run, []).append((result.scene, result.warning))
        return [*self.hints, *(f"{run}: {line}" for run, lines in by_run.items() for line in summarized(lines))]

    @property
    def n_scenes(self) -> int:
        """Number of scenes."""
        return len({result.scene for result in self.results})

    @cached_property
    def sections(self) -> list[Section]:
        """Sections of all data sets and protocols that have scores; no mean is taken over several of them."""
        groups: dict[tuple[str, str], list[MapResult]] = {}
        for result in self.results:
            if result.scores:
                groups.setdefault((result.data_set, result.protocol), []).append(result)
        return [Section(d, self.protocols[p], self.runs, tuple(results)) for (d, p), results in groups.items()]

    def records(self) -> list[Record]:
        """Return every number of the evaluation: of all results, then the means of every section."""
        made = [record for result in self.results for record in result.records()]
        return made + [record for section in self.sections for record in section.records()]

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain values; NaN where there is no number."""
        return {
            "truth": self.truth,
            "runs": list(self.runs),
            "plugins": self.plugins,
            "results": [result.to_dict() for result in self.results],
            "means": [row for section in self.sections for row in section.rows()],
            "headlines": [row for section in self.sections for row in section.overall_rows()],
            "by_threshold": [row for section in self.sections for row in section.threshold_rows()],
            "comparisons": [
                {
                    "data_set": section.data_set,
                    "protocol": section.protocol.name,
                    "run": run,
                    "against": section.ranking.runs[0],
                    **vars(test),
                    "p_holm": section.ranking.p_values[run],
                    "significant": section.ranking.is_significant(run),
                }
                for section in self.sections
                for run, test in section.ranking.tests.items()
            ],
            "failed": [{"run": r.run, "scene": r.scene, "reason": r.error} for r in self.failed],
            "warnings": self.warnings,
            **self.flags.to_dict(),
        }


def run_names(places: Sequence[Path]) -> list[str]:
    """Return names of folders or files, with as many parents as make them differ; InputError where two are one."""
    parts = [place.resolve().parts for place in places]
    for depth in range(1, max(len(p) for p in parts) + 1):
        names = ["_".join(p[-depth:]).strip("/") or "run" for p in parts]
        if len(set(names)) == len(names):
            return names
    raise InputError("the same run is given twice")
