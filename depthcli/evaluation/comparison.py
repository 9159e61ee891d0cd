"""Runs compared: the results of a data set under one protocol, their means and ranks, and the whole evaluation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from depthcli.core.text import summarized
from depthcli.evaluation.protocols import AnyProtocol, scene_means
from depthcli.evaluation.scores import COMMON_MEAN, MEAN, Key, MapResult, Score, in_order, record
from depthcli.evaluation.statistics import Ranking, average_ranks
from depthcli.run.flags import Flags


class Section:
    """The results of one data set under one protocol; every run has a result for every scene.

    A run's mean over **all** scenes counts a scene without a map as wholly wrong. The mean over the **common** scenes,
    of which every run has a map, compares what was computed. Ranks are taken over the common scenes alone. A mean in
    one region is over those of the scenes that have truth in it (``scenes_with``).

    Attributes
    ----------
    scenes, common : names of all scenes, and of those of which every run has a map
    incomplete : some run has no map of some scene
    regions : names of the regions, in the protocol's order; the first is the main region
    keys : all pairs of metric and region that have a score
    known : region -> scenes whose truth is known somewhere in it
    means : (run, over the common scenes alone) -> (metric, region) -> mean
    figure_regions : regions that the single figure of a run is taken over: the protocol's, without those that some
        scene lacks, so that every scene counts alike; or else the main region
    """

    def __init__(
        self, data_set: str, protocol: AnyProtocol, runs: tuple[str, ...], results: Sequence[MapResult]
    ) -> None:
        self.data_set, self.protocol, self.runs, self.results = data_set, protocol, runs, tuple(results)
        self.scenes = list(dict.fromkeys(result.scene for result in results))
        self.common = frozenset(self.scenes) - {result.scene for result in results if result.error}
        self.incomplete = len(self.common) < len(self.scenes)
        scored = [(score, result.scene) for result in results for score in result.scores]
        self.keys = list(dict.fromkeys(score.key for score, _ in scored))
        self.regions = in_order((score.region for score, _ in scored), protocol.region_order)
        self.known = {
            region: frozenset(scene for s, scene in scored if s.region == region and not math.isnan(s.density))
            for region in self.regions
        }
        self.means: dict[tuple[str, bool], dict[Key, Score]] = {}
        for run in runs:
            self.means[run, False] = {score.key: score for score in protocol.mean(self.results_of(run))}
            self.means[run, True] = self.means[run, False]
            if self.incomplete:
                self.means[run, True] = {score.key: score for score in protocol.mean(self.results_of(run, True))}
        named = self.regions if protocol.averages_regions else self.regions[:1]
        self.figure_regions = [name for name in named if len(self.known[name]) == len(self.scenes)] or named[:1]
        self._figure_keys: list[Key] = [(protocol.headline, region) for region in self.figure_regions]
        self._where = {"data_set": data_set, "protocol": protocol.name}

    def scenes_with(self, region: str, common: bool = False) -> frozenset[str]:
        """Return the names of the scenes, or common scenes, whose truth is known somewhere in a region."""
        return self.known[region] & self.common if common else self.known[region]

    def results_of(self, run: str, common: bool = False) -> list[MapResult]:
        """Return one run's results of all scenes, or of the common ones."""
        return [r for r in self.results if r.run == run and (not common or r.scene in self.common)]

    def n_missing(self, run: str, region: str | None = None) -> int:
        """Return the number of scenes, or of those with truth in a region, of which a run has no map."""
        missing = {result.scene for result in self.results_of(run) if result.error}
        return len(missing if region is None else missing & self.known[region])

    def mean(self, run: str, key: Key, common: bool = False) -> Score:
        """Return a run's mean over all scenes or the common ones; NaN if there is none."""
        return self.means[run, common].get(key) or Score(*key, math.nan, 0, math.nan)

    def overall(self, run: str, common: bool = False) -> Score:
        """Return the single figure of a run, the headline over ``figure_regions``; NaN if there is none."""
        keys = self._figure_keys
        if len(keys) == 1:  # the mean of that region, which a protocol may compute in its own way
            return self.mean(run, keys[0], common)
        scored = (([r.by_key[k] for k in keys if k in r.by_key], r.scene) for r in self.results_of(run, common))
        together = [([replace(s, region=keys[0][1]) for s in scores], scene) for scores, scene in scored]
        return (scene_means(self.protocol, together) or [self.mean(run, keys[0], common)])[0]

    def threshold_curve(self, run: str) -> list[Score]:
        """Return the means over all scenes of one metric at many thresholds."""
        return scene_means(self.protocol, ((r.dense, r.scene) for r in self.results_of(run)))

    def by_scene(self, run: str) -> list[float]:
        """Return one run's single figure of every scene, lower is better: signed; NaN if there is no map."""
        keys = self._figure_keys
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
        return Ranking(order, {run: self.by_scene(run) for run in self.runs})

    def average_rank(self, keys: Sequence[Key]) -> dict[str, float]:
        """Return run -> mean rank over the common scenes and (metric, region) pairs; equal values share a rank."""
        results = [self.results_of(run, common=True) for run in self.runs]
        grid = [[key[0].sign * r.by_key[key].value for r in row for key in keys if key in r.by_key] for row in results]
        ranks = average_ranks(np.array(grid, np.float64).reshape(len(self.runs), -1))
        return {run: float(rank) for run, rank in zip(self.runs, ranks, strict=True)}

    def records(self) -> list[dict[str, Any]]:
        """Return the means of every run, metric and region, over all scenes and common ones, for ``scores.csv``."""
        made = []
        for run in self.runs:
            for key in self.means[run, False]:
                n_missing = self.n_missing(run, key[1])
                missing = f", {n_missing} missing ones counted as wholly wrong" if n_missing else ""
                notes = (
                    f"over {len(self.scenes_with(key[1]))} scenes{missing}",
                    f"over the {len(self.scenes_with(key[1], common=True))} scenes that all runs have",
                )
                for scene, common, note in zip((MEAN, COMMON_MEAN), (False, True), notes, strict=True):
                    made.append(
                        record({"run": run, **self._where, "scene": scene}, self.mean(run, key, common), note=note)
                    )
        return made

    def row(self, run: str, score: Score, common: Score) -> dict[str, Any]:
        """Return a mean over all scenes, and that over the common ones, as plain values."""
        return {
            "run": run, **self._where, **score.row(), "scenes": len(self.scenes_with(score.region)),
            "missing": self.n_missing(run, score.region),
            "common": len(self.scenes_with(score.region, common=True)), "value_common": common.value,
        }  # fmt: skip


@dataclass(frozen=True)
class EvaluationReport:
    """All results of an evaluation, in the order of the scenes, then of the runs."""

    runs: tuple[str, ...]
    results: tuple[MapResult, ...]
    protocols: dict[str, AnyProtocol]  # by name, all that the results name
    truth: str  # folder or file of the ground truth, as people may see it
    hints: tuple[str, ...] = ()  # what was assumed, and what looks wrong with the way scenes are scored, one line each
    plugins: dict[str, str] = field(default_factory=dict)  # package -> version, of those that took part
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
        return [Section(d, self.protocols[p], self.runs, results) for (d, p), results in groups.items()]

    def records(self) -> list[dict[str, Any]]:
        """Return the rows of ``scores.csv``: every number of all results, then the means of every section."""
        made = [record for result in self.results for record in result.records()]
        return made + [record for section in self.sections for record in section.records()]

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain values; NaN where there is no number."""
        each = [(section, run) for section in self.sections for run in section.runs]
        by_threshold: list[dict[str, Any]] = []  # the lines of the plot, of every run that has one
        for section, run in each:
            if scores := section.threshold_curve(run):
                m = scores[0].metric
                by_threshold.append({
                    "run": run, "data_set": section.data_set, "protocol": section.protocol.name, "metric": m.name,
                    "mask": scores[0].region, "unit": m.unit, "convention": m.convention,
                    "thresholds": [s.metric.threshold for s in scores], "values": [s.value for s in scores],
                })  # fmt: skip
        return {
            "truth": self.truth,
            "runs": list(self.runs),
            "plugins": self.plugins,
            "results": [result.to_dict() for result in self.results],
            "means": [
                section.row(run, score, section.mean(run, key, common=True))
                for section, run in each
                for key, score in section.means[run, False].items()
            ],
            "headlines": [
                section.row(run, section.overall(run), section.overall(run, common=True))
                | {"mask": "+".join(section.figure_regions)}
                for section, run in each
            ],
            "by_threshold": by_threshold,
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
