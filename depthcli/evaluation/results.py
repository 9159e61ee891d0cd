"""What an evaluation found: results by run and scene, their means, comparisons, and all of it as plain data."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from depthcli.core.errors import InputError
from depthcli.evaluation.curves import Sparsification
from depthcli.evaluation.report import Table
from depthcli.evaluation.scores import Measure, Score, find_score
from depthcli.evaluation.summary import Comparison, compare

if TYPE_CHECKING:
    from depthcli.evaluation.protocols import Protocol

_COLUMNS = (
    "run", "data_set", "scene", "protocol", "metric", "threshold", "mask", "value", "unit", "wrong", "pixels",
    "density", "convention", "map", "note",
)  # fmt: skip


@dataclass(frozen=True)
class Curve:
    """A sparsification curve: its region and confidence measure, ``bad`` (wrong pixels) or ``error``, and the line."""

    mask: str
    confidence: str
    of: str
    line: Sparsification


@dataclass(frozen=True)
class Result:
    """One map of one run against the truth of one scene, or the reason why there is none.

    Attributes
    ----------
    run, scene, data_set, protocol : where the numbers belong
    source : the map's path inside its run folder, or empty
    scores : where the map is missing, the worst of every measure (``Protocol.missing``); empty where there is no
        usable truth
    dense : the same measure at many thresholds, for plots (``Protocol.dense``)
    curves : of the confidence maps beside the map
    seconds : time of the run's report, or NaN
    size : pixels (or voxels) of the truth, known or not; 0 where there is no map
    disparities : how many the run searched, 0 where its report does not say
    warning : suspicions about the map, or empty
    error : why there is no map to score, or empty
    evidence : what the protocol keeps for its means
    """

    run: str
    scene: str
    data_set: str
    protocol: str
    source: str = ""
    scores: tuple[Score, ...] = ()
    dense: tuple[Score, ...] = ()
    curves: tuple[Curve, ...] = ()
    seconds: float = math.nan
    size: int = 0
    disparities: int = 0
    warning: str = ""
    error: str = ""
    evidence: Any = field(default=None, repr=False, compare=False)

    def value(self, metric: str, mask: str, threshold: float | None = None, convention: str | None = None) -> float:
        """One number of this result; KeyError where there is none of that name, or more than one fits."""
        return find_score(self.scores, metric, mask, threshold, convention).value

    @cached_property
    def by_key(self) -> dict[tuple[Measure, str], Score]:
        """(measure, region) -> score."""
        return {(score.measure, score.mask): score for score in self.scores}

    @property
    def picture(self) -> str:
        """Path of its error picture in a report's folder."""
        return f"errors/{self.run}/{self.scene}.png"

    @property
    def plots(self) -> dict[tuple[str, str], str]:
        """(region, kind of curve) -> path of the plot in a report's folder."""
        return {(c.mask, c.of): f"curves/{self.run}/{self.scene}_{c.mask}_{c.of}.svg" for c in self.curves}

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain values."""
        return {
            "run": self.run, "scene": self.scene, "data_set": self.data_set, "protocol": self.protocol,
            "map": self.source, "seconds": self.seconds, "missing": bool(self.error),
            "warning": self.warning or None, "error": self.error or None,
            "scores": [score.row() for score in self.scores],
            "confidence": [
                {"measure": c.confidence, "mask": c.mask, "of": c.of, **vars(c.line), **c.line.areas()}
                for c in self.curves
            ],
        }  # fmt: skip


@dataclass(frozen=True)
class Section:
    """The results of one data set under one protocol; every scene of it has results for every run.

    A run's mean over **all** scenes counts one without a map as wholly wrong. The mean over the **common** scenes,
    which every run has, compares what was computed. Ranks are taken over common scenes alone.
    """

    data_set: str
    protocol: Protocol[Any, Any]
    runs: tuple[str, ...]
    results: tuple[Result, ...]

    @cached_property
    def scenes(self) -> list[str]:
        """All scenes, in order."""
        return list(dict.fromkeys(result.scene for result in self.results))

    @cached_property
    def common(self) -> frozenset[str]:
        """Scenes of which every run has a map."""
        return frozenset(self.scenes) - {result.scene for result in self.results if result.error}

    @cached_property
    def masks(self) -> list[str]:
        """Regions, in the protocol's order."""
        return self.protocol.ordered({score.mask: None for result in self.results for score in result.scores})

    @property
    def incomplete(self) -> bool:
        """Some run lacks a scene."""
        return len(self.common) < len(self.scenes)

    def of(self, run: str, common: bool = False) -> list[Result]:
        """One run's results over all, or the common, scenes."""
        return [r for r in self.results if r.run == run and (not common or r.scene in self.common)]

    def lacking(self, run: str) -> int:
        """Number of scenes of which a run has no map."""
        return sum(bool(result.error) for result in self.of(run))

    def means(self, run: str, common: bool = False) -> dict[tuple[Measure, str], Score]:
        """(measure, region) -> mean over all, or the common, scenes."""
        return self._means[run, common]

    @cached_property
    def _means(self) -> dict[tuple[str, bool], dict[tuple[Measure, str], Score]]:
        return {
            (run, common): {(s.measure, s.mask): s for s in self.protocol.mean(self.of(run, common))}
            for run in self.runs
            for common in (False, True)
        }

    def dense(self, run: str) -> list[Score]:
        """One measure at many thresholds: means over all scenes, as :meth:`means` takes them."""
        return self.protocol.pooled((r.dense, r.scene) for r in self.of(run))

    def figure(self, run: str, common: bool = False) -> Score | None:
        """The one figure of a run: the headline over its scenes and the protocol's regions for it; None of no scene."""
        masks = self.protocol.figure_masks(self.masks)
        if len(masks) == 1:  # the mean of that region, which a protocol may take in its own way
            return self.means(run, common).get((self.protocol.headline, masks[0]))
        pairs = [
            (score, self.protocol.weight(result.scene))
            for result in self.of(run, common)
            for mask in masks
            if (score := result.by_key.get((self.protocol.headline, mask))) is not None
        ]
        return self.protocol.pool(*zip(*pairs, strict=True)) if pairs else None

    def signed(self, run: str) -> list[float]:
        """One run's headline in the main region by scene, so that lower is better; NaN without a map."""
        headline = self.protocol.headline
        scores = [None if r.error else r.by_key.get((headline, self.masks[0])) for r in self.of(run)]
        sign = -1 if headline.larger_is_better else 1
        return [math.nan if score is None else sign * score.value for score in scores]

    def row(self, run: str, score: Score, common: Score | None) -> dict[str, Any]:
        """A mean over all scenes (``value``; ``missing`` ones count as wholly wrong) and over the common ones."""
        return {
            "run": run, "data_set": self.data_set, "protocol": self.protocol.name, **score.row(),
            "scenes": len(self.scenes), "missing": self.lacking(run), "common": len(self.common),
            "value_common": math.nan if common is None else common.value,
        }  # fmt: skip


@dataclass(frozen=True)
class EvaluationReport:
    """All results, in the order of the scenes, then of the runs.

    Attributes
    ----------
    runs : names of the runs
    results : one for every scene and run
    protocols : name -> protocol, of all that the results name
    truth : folder or file
    """

    runs: tuple[str, ...]
    results: tuple[Result, ...]
    protocols: dict[str, Protocol[Any, Any]]
    truth: Path

    @property
    def failed(self) -> list[Result]:
        """Results that hold a reason."""
        return [result for result in self.results if result.error]

    @property
    def warnings(self) -> list[str]:
        """Suspicions, one line each."""
        return [f"{r.run}: {r.scene}: {r.warning}" for r in self.results if r.warning]

    @property
    def scenes(self) -> int:
        """Number of scenes."""
        return len({result.scene for result in self.results})

    @cached_property
    def sections(self) -> list[Section]:
        """Data sets and protocols that have scores."""
        return self._sections(lambda result: result.data_set)

    @cached_property
    def by_protocol(self) -> list[Section]:
        """All scenes of a protocol together, whatever their data set."""
        return self._sections(lambda result: "all scenes")

    def _sections(self, name: Callable[[Result], str]) -> list[Section]:
        groups: dict[tuple[str, str], list[Result]] = {}
        for result in self.results:
            if result.scores:
                groups.setdefault((name(result), result.protocol), []).append(result)
        return [Section(d, self.protocols[p], self.runs, tuple(results)) for (d, p), results in groups.items()]

    def comparisons(self) -> list[tuple[Section, str, Comparison]]:
        """Every further run against the first, by protocol: the headline in the main region, scenes that both have."""
        made = []
        for section in self.by_protocol:
            values = [section.signed(run) for run in self.runs]
            made += [(section, run, compare(values[0], v)) for run, v in zip(self.runs[1:], values[1:], strict=True)]
        return made

    def tables(self) -> list[Table]:
        """Every table of the report."""
        from depthcli.evaluation import tables

        made = [table for section in self.sections for table in section.protocol.tables(section)]
        made += [*tables.overview(self), *tables.comparison(self), *tables.confidence(self)]
        if self.failed:
            rows = tuple((r.run, r.scene, r.error) for r in self.failed)
            made.append(Table("Not evaluated", ("run", "scene", "reason"), rows))
        return made

    def text(self) -> str:
        """The tables and warnings for a terminal."""
        blocks = [table.text() for table in self.tables()]
        if self.warnings:
            blocks.append("".join(f"warning: {line}\n" for line in self.warnings))
        return "\n".join(blocks)

    def markdown(self) -> str:
        """The tables, with links to pictures and plots."""
        runs = ", ".join(f"`{run}`" for run in self.runs)
        out = ["# Evaluation", "", f"Ground truth: `{self.truth}`. Runs: {runs}.", ""]
        out += [f"**Warning:** {line}\n" for line in self.warnings]
        out += [table.markdown() for table in self.tables()]
        out += ["## Error pictures", ""]
        out += [f"{judge.name}: {judge.legend}.\n" for judge in self.protocols.values() if judge.legend]
        for r in self.results:
            if not r.error:
                out += [f"{r.run}, {r.scene}:", "", f"![{r.scene}]({_link(r.picture)})", ""]
                out += [f"![{of}, {mask}]({_link(path)})\n" for (mask, of), path in r.plots.items()]
        return "\n".join(out)

    def means(self) -> list[dict[str, Any]]:
        """Every measure by data set, run and region: :meth:`Section.row`."""
        return [
            section.row(run, score, section.means(run, common=True).get(key))
            for section in self.sections
            for run in self.runs
            for key, score in section.means(run).items()
        ]

    def headlines(self) -> list[dict[str, Any]]:
        """The one figure of every run in every data set, as :meth:`means` has them."""
        return [
            {**section.row(run, score, section.figure(run, common=True)), "mask": "+".join(masks)}
            for section in self.sections
            for masks in [section.protocol.figure_masks(section.masks)]
            for run in self.runs
            if (score := section.figure(run)) is not None
        ]

    def by_threshold(self) -> list[dict[str, Any]]:
        """The lines of the plots against the threshold: of every run in every data set a measure, and its values."""
        made = []
        for section in self.sections:
            for run in self.runs:
                scores = section.dense(run)
                if scores:
                    m = scores[0].measure
                    made.append({
                        "run": run, "data_set": section.data_set, "protocol": section.protocol.name,
                        "metric": m.metric, "mask": scores[0].mask, "unit": m.unit, "convention": m.convention,
                        "thresholds": [s.measure.threshold for s in scores], "values": [s.value for s in scores],
                    })  # fmt: skip
        return made

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain values; NaN where there is no number."""
        return {
            "truth": str(self.truth),
            "runs": list(self.runs),
            "results": [result.to_dict() for result in self.results],
            "means": self.means(),
            "headlines": self.headlines(),
            "by_threshold": self.by_threshold(),
            "comparisons": [
                {
                    "protocol": section.protocol.name,
                    "run": run,
                    "against": self.runs[0],
                    "better": run if c.wins > c.losses else self.runs[0] if c.losses > c.wins else None,
                    **vars(c),
                }
                for section, run, c in self.comparisons()
            ],
            "failed": [{"run": r.run, "scene": r.scene, "reason": r.error} for r in self.failed],
            "warnings": self.warnings,
        }

    def rows(self) -> list[dict[str, Any]]:
        """A row a number; then the means (scene ``*mean`` over all scenes, ``*common mean`` over those of all runs)."""
        rows: list[dict[str, Any]] = []
        for r in self.results:
            base = {"run": r.run, "data_set": r.data_set, "scene": r.scene, "protocol": r.protocol, "map": r.source}
            note = f"missing, counted as wholly wrong: {r.error}" if r.error else r.warning
            rows += [{**base, **score.row(), "note": note} for score in r.scores]
            for c in r.curves:
                about = {**base, "mask": c.mask, "pixels": c.line.pixels}
                areas = c.line.areas().items()
                rows += [{**about, "metric": f"{area}:{c.confidence}:{c.of}", "value": value} for area, value in areas]
            if r.error:
                rows.append({**base, "metric": "failed", "note": r.error})
        for mean in self.means():
            missing = f", {mean['missing']} missing ones counted as wholly wrong" if mean["missing"] else ""
            rows.append({**mean, "scene": "*mean", "note": f"over {mean['scenes']} scenes{missing}"})
            common = {"value": mean["value_common"], "note": f"over the {mean['common']} scenes that all runs have"}
            rows.append({**mean, "scene": "*common mean", **common, **dict.fromkeys(("density", "pixels", "wrong"))})
        return [{key: _cell(row.get(key)) for key in _COLUMNS} for row in rows]


def _cell(value: Any) -> Any:
    return "" if value is None or (isinstance(value, float) and not math.isfinite(value)) else value


def _link(path: str) -> str:
    return path.replace(" ", "%20").replace("(", "%28").replace(")", "%29")


def run_names(places: Sequence[Path]) -> list[str]:
    """Names of folders or files, with as many parents as it takes to tell them apart; InputError where two are one."""
    parts = [place.resolve().parts for place in places]
    for depth in range(1, max(len(p) for p in parts) + 1):
        names = ["_".join(p[-depth:]).strip("/") or "run" for p in parts]
        if len(set(names)) == len(names):
            return names
    raise InputError("the same run is given twice")
