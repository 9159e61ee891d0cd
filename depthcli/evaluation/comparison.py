"""Runs compared: the results of a data set under one protocol, their means and ranks, and the whole evaluation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from depthcli.core.text import summarized
from depthcli.evaluation.bounds import bound_means
from depthcli.evaluation.protocols import AnyProtocol
from depthcli.evaluation.scores import COMMON_MEAN, MEAN, Key, MapResult, Score, in_order, record
from depthcli.evaluation.statistics import PairedTest, Ranking, average_ranks, compare_all
from depthcli.run.flags import Flags


class Section:
    """The results of one data set under one protocol; every run has a result for every scene.

    The mean over all scenes (``MEAN``) counts all pixels of a scene without a map as incorrect. The mean over the
    common scenes (``COMMON_MEAN``), of which every run has a map, compares computed maps only, and so do ranks. A mean
    in one region is over the scenes that have ground truth in it.

    Attributes
    ----------
    scenes, common : names of all scenes, and of the scenes with a map of every run
    missing : run -> names of the scenes without a map of this run
    places : the means that differ, ``MEAN`` first
    regions : names of the regions, in the protocol's order; the first is the main region
    keys : all pairs of metric and region that have a score
    known : region -> scenes with known ground truth in it
    scores : (run, scene or mean) -> (metric, region) -> score
    bounds : run -> mean scores of its error bounds, over all maps that have them; empty without such maps
    figure_regions : regions that enter the single figure of a run: regions of the protocol that all scenes have, so
        that every scene counts alike; if there are none, the main region
    """

    def __init__(
        self, data_set: str, protocol: AnyProtocol, runs: tuple[str, ...], results: Sequence[MapResult]
    ) -> None:
        self.data_set, self.protocol, self.runs, self.results = data_set, protocol, runs, tuple(results)
        self.missing: dict[str, set[str]] = {run: set() for run in runs}
        self.scores: dict[tuple[str, str], dict[Key, Score]] = {}
        known: dict[str, set[str]] = {}
        scenes, keys = dict[str, None](), dict[Key, None]()
        for r in results:
            scenes[r.scene] = None
            if r.error:
                self.missing[r.run].add(r.scene)
            self.scores[r.run, r.scene] = {score.key: score for score in r.scores}
            for key, score in self.scores[r.run, r.scene].items():
                keys[key] = None
                known.setdefault(score.region, set()).update([] if math.isnan(score.density) else [r.scene])
        self.scenes, self.keys = list(scenes), list(keys)
        self.common = set(scenes).difference(*self.missing.values())
        self.places = [MEAN] if len(self.common) == len(self.scenes) else [MEAN, COMMON_MEAN]
        self.regions = in_order(known, protocol.region_order)
        self.known = {region: known[region] for region in self.regions}
        for run in runs:
            for place in self.places:
                self.scores[run, place] = {score.key: score for score in protocol.mean(self.results_of(run, place))}
        self.bounds = {run: bound_means([r.bounds for r in self.results_of(run) if r.bounds]) for run in runs}
        named = self.regions if protocol.averages_regions else self.regions[:1]
        self.figure_regions = [name for name in named if len(self.known[name]) == len(self.scenes)] or named[:1]
        self.figure_keys: list[Key] = [(protocol.headline, region) for region in self.figure_regions]

    def results_of(self, run: str, place: str = MEAN) -> list[MapResult]:
        """Return one run's results of all scenes, or of the common scenes."""
        return [r for r in self.results if r.run == run and (place == MEAN or r.scene in self.common)]

    def counts(self, run: str, region: str | None = None) -> dict[str, int]:
        """Count the scenes with ground truth in a region: all, without a map of the run, and with maps of all runs."""
        scenes = set(self.scenes) if region is None else self.known[region]
        return {
            "scenes": len(scenes),
            "missing": len(scenes & self.missing[run]),
            "common": len(scenes & self.common),
        }

    def score(self, run: str, place: str, key: Key) -> Score:
        """Return the score of a scene, or a mean; NaN if there is none."""
        if place == COMMON_MEAN:
            place = self.places[-1]
        return self.scores[run, place].get(key) or Score(*key, math.nan, 0, math.nan)

    def overall(self, run: str, place: str = MEAN) -> Score:
        """Return the single figure of a run, the mean headline over ``figure_regions``; NaN if there is none."""
        keys = self.figure_keys
        if len(keys) == 1:  # the mean of that region, which a protocol may compute in its own way
            return self.score(run, place, keys[0])
        scored: list[tuple[list[Score], str]] = []
        for r in self.results_of(run, place):
            scores = self.scores[run, r.scene]
            scored.append(([replace(scores[key], region=keys[0][1]) for key in keys if key in scores], r.scene))
        return (self.protocol.pooled(scored) or [self.score(run, place, keys[0])])[0]

    def threshold_curve(self, run: str) -> list[Score]:
        """Return one metric at many thresholds over all scenes, by the protocol's rule."""
        return self.protocol.pooled((r.dense, r.scene) for r in self.results_of(run))

    @cached_property
    def by_scene(self) -> dict[str, list[float]]:
        """Run -> single figure of every scene, with a sign that makes lower values better; NaN if there is no map."""
        figures: dict[str, list[float]] = {run: [] for run in self.runs}
        for run, values in figures.items():
            for scene in self.scenes:
                total = math.fsum(self.score(run, scene, key).value for key in self.figure_keys)
                figure = self.protocol.headline.sign * total / len(self.figure_keys)
                values.append(math.nan if scene in self.missing[run] else figure)
        return figures

    @cached_property
    def ranking(self) -> Ranking:
        """The runs from the best single figure to the worst; runs without one last, by the common scenes."""
        if len(self.runs) == 1:
            return Ranking(self.runs, {})
        order: list[tuple[Any, ...]] = []
        for number, run in enumerate(self.runs):
            values = (self.protocol.headline.sign * self.overall(run, place).value for place in (MEAN, COMMON_MEAN))
            order.append((*[(math.isnan(v), 0.0 if math.isnan(v) else v) for v in values], number, run))
        return Ranking([run for *_, run in sorted(order)], self.by_scene, self.average_rank(self.figure_keys))

    @cached_property
    def pairs(self) -> list[tuple[str, str, PairedTest, float]]:
        """Run, other run, test of the second against the first, and its corrected p value: all pairs of runs."""
        return compare_all({run: self.by_scene[run] for run in self.ranking.runs})

    def average_rank(self, keys: Sequence[Key]) -> dict[str, float]:
        """Return run -> mean rank over the common scenes and (metric, region) pairs; equal values share a rank."""
        scored = {run: [self.scores[run, r.scene] for r in self.results_of(run, COMMON_MEAN)] for run in self.runs}
        grid = [[key[0].sign * s[key].value for s in scored[run] for key in keys if key in s] for run in self.runs]
        ranks = average_ranks(np.array(grid, np.float64).reshape(len(self.runs), -1))
        return dict(zip(self.runs, ranks.tolist(), strict=True))

    def records(self) -> list[dict[str, Any]]:
        """Return the means of every run, metric and region, over all scenes and common scenes, for ``scores.csv``."""
        rows = []
        for run in self.runs:
            where = {"run": run, "data_set": self.data_set, "protocol": self.protocol.name}
            for key in self.scores[run, MEAN]:
                counts = self.counts(run, key[1])
                missing = f", {counts['missing']} missing, all their pixels incorrect" if counts["missing"] else ""
                for place, note in (
                    (MEAN, f"over {counts['scenes']} scenes{missing}"),
                    (COMMON_MEAN, f"over the {counts['common']} scenes that all runs have"),
                ):
                    where["scene"] = place.replace("mean", self.protocol.presentation.mean_heading)
                    rows.append(record(where, self.score(run, place, key), note=note))
            note = f"over {sum(bool(r.bounds) for r in self.results_of(run))} maps with bounds"
            rows += [record(where | {"scene": MEAN}, score, note=note) for score in self.bounds[run]]
        return rows

    def to_dict(self, with_pairs: bool) -> dict[str, list[dict[str, Any]]]:
        """Return means, figures, curves and tests as plain values."""
        parts: dict[str, list[dict[str, Any]]] = {
            "means": [], "headlines": [], "by_threshold": [], "bounds": [], "comparisons": [], "pairs": []
        }  # fmt: skip
        about = {"data_set": self.data_set, "protocol": self.protocol.name}
        statistic = {"statistic": self.protocol.presentation.mean_heading}
        for run in self.runs:
            where = {"run": run, **about}
            for key in self.scores[run, MEAN]:
                common = {"value_common": self.score(run, COMMON_MEAN, key).value}
                score = self.score(run, MEAN, key)
                parts["means"].append(where | score.row() | self.counts(run, score.region) | common | statistic)
            score, common = self.overall(run), {"value_common": self.overall(run, COMMON_MEAN).value}
            row = where | score.row() | self.counts(run, score.region) | common | statistic
            parts["headlines"].append(row | {"mask": "+".join(self.figure_regions)})
            parts["bounds"] += [where | score.row() for score in self.bounds[run]]
            if curve := self.threshold_curve(run):
                m = curve[0].metric
                parts["by_threshold"].append({
                    **where, "metric": m.name, "mask": curve[0].region, "unit": m.unit, "convention": m.convention,
                    "thresholds": [s.metric.threshold for s in curve], "values": [s.value for s in curve], **statistic,
                })  # fmt: skip
        ranking = self.ranking
        for run, test in ranking.tests.items():
            result = {"p_holm": ranking.p_values[run], "significant": ranking.is_significant(run)}
            parts["comparisons"].append({**about, "run": run, "against": ranking.runs[0], **vars(test), **result})
        for a, b, test, p in self.pairs if with_pairs else ():
            parts["pairs"].append({**about, "run": b, "against": a, **vars(test), "p_holm": p})
        return parts


@dataclass(frozen=True)
class EvaluationReport:
    """All results of an evaluation, in the order of the scenes, then of the runs."""

    runs: tuple[str, ...]
    results: tuple[MapResult, ...]
    protocols: dict[str, AnyProtocol]  # by name, all that the results name
    truth: str  # folder or file of the ground truth, as people may see it
    hints: tuple[str, ...] = ()  # assumptions, and doubts about the way scenes are scored, one line each
    plugins: dict[str, str] = field(default_factory=dict)  # package -> version, of those that took part
    flags: Flags = field(default_factory=Flags)
    unwritten: dict[str, str] = field(default_factory=dict)  # file of a page or sheet -> why it could not be written
    with_pairs: bool = False  # all pairs of runs are tested

    @property
    def incomplete(self) -> bool:
        """Return whether maps, ground truth, the page or the sheet are missing, for which the exit code is 3."""
        return bool(self.failed or self.unwritten)

    @property
    def failed(self) -> list[MapResult]:
        """Results without a usable map or truth."""
        return [result for result in self.results if result.error]

    def warnings(self, together: bool = False, with_reports: bool = True) -> list[str]:
        """Return warnings about scenes and maps, one line each.

        ``together``: print one line for warnings of a run that differ only in numbers and scenes.
        ``with_reports=False`` leaves out warnings of the runs' own reports.
        """
        lines = [*self.hints]
        for section in self.sections:
            left_out = f"no map of {section.data_set} can be read: left out of its tables, ranks and tests"
            lines += [f"{run}: {left_out}" for run in self.runs if run not in section.runs]
        of_run: dict[str, list[tuple[str, str]]] = {run: [] for run in self.runs}
        for r in self.results:
            for line in filter(None, (r.warning, *(r.run_warnings if with_reports else ()))):
                of_run[r.run].append((r.scene, line))
                lines += [] if together else [f"{r.run}: {r.scene}: {line}"]
        for run, of_maps in of_run.items() if together else ():
            lines += [f"{run}: {line}" for line in summarized(of_maps)]
        return lines

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
        sections = []
        for (data_set, protocol), results in groups.items():
            # A run without any map of the data set was not computed, or cannot be read: it is not compared.
            usable = {r.run for r in results if not r.error} or set(self.runs)
            runs = tuple(run for run in self.runs if run in usable)
            kept = [result for result in results if result.run in runs]
            sections.append(Section(data_set, self.protocols[protocol], runs, kept))
        return sections

    def records(self) -> list[dict[str, Any]]:
        """Return the rows of ``scores.csv``: every number of all results, then the means of every section."""
        rows = [row for result in self.results for row in result.records()]
        return rows + [row for section in self.sections for row in section.records()]

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain values; NaN for no number."""
        parts: dict[str, list[dict[str, Any]]] = {
            "means": [], "headlines": [], "by_threshold": [], "bounds": [], "comparisons": [], "pairs": []
        }  # fmt: skip
        for section in self.sections:
            for name, rows in section.to_dict(self.with_pairs).items():
                parts[name] += rows
        pairs = parts.pop("pairs")
        return {
            "truth": self.truth,
            "runs": list(self.runs),
            "plugins": self.plugins,
            "results": [result.to_dict() for result in self.results],
            **parts,
            "failed": [{"run": r.run, "scene": r.scene, "reason": r.error} for r in self.failed],
            "warnings": self.warnings(),
            **(self.flags.to_dict() if self.flags.conditions else {}),
            **({"unwritten": self.unwritten} if self.unwritten else {}),
            **({"pairs": pairs} if self.with_pairs else {}),
        }
