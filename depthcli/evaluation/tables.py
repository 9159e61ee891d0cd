"""Tables of an evaluation, made from what a protocol declares."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from depthcli.evaluation.report import Table, number
from depthcli.evaluation.results import Curve, EvaluationReport, Section
from depthcli.evaluation.scores import Measure, Score
from depthcli.evaluation.summary import average_ranks

_STAR = "*: scenes without a map count as wholly wrong; where a measure has no worst value there is no mean over all"


def summary(section: Section) -> Table:
    """A row a run: the headline by region, the one figure, the average rank; a second row over the common scenes."""
    protocol, headline, main = section.protocol, section.protocol.headline, section.masks[0]
    over = [(headline, mask) for mask in protocol.figure_masks(section.masks)]
    ranks = {run: number(rank, 1) for run, rank in average_rank(section, over).items()}
    several = protocol.averages_masks and len(section.masks) > 1
    timed = any(not math.isnan(result.seconds) for result in section.results)
    rows = []
    for run, common, mark in _run_rows(section):
        means = section.means(run, common)
        cells = [_cell(means.get((headline, mask)), mark) for mask in section.masks]
        cells += [_cell(section.figure(run, common), mark)] * several
        cells += [ranks[run] if common or not section.incomplete else ""]
        score = means.get((headline, main))
        cells += ["-" if score is None else number(score.density, 1)]
        cells += [number(mean(r.seconds for r in section.of(run, common)))] * timed
        rows.append((run, _scenes(section, run, common), *cells))
    header = ["run", "scenes", *section.masks, *["mean of all figures"] * several, "avg rank", f"density {main} %"]
    title = f"{section.data_set} - {protocol.title} ({headline.heading})"
    return Table(title, (*header, *["seconds"] * timed), tuple(rows), _note(section))


def details(section: Section) -> list[Table]:
    """Every measure: a table a region, with a row a run and scene; or one table of the means alone."""
    by_scene = section.protocol.scene_rows
    made: list[Table] = []
    for mask in section.masks:
        keys = list(dict.fromkeys((s.measure, mask) for r in section.results for s in r.scores if s.mask == mask))
        rows = []
        for run, common, mark in _run_rows(section):
            if by_scene and not common:
                rows += [
                    (run, short(r.scene) + "*" * bool(r.error), *(_cell(r.by_key.get(key)) for key in keys))
                    for r in section.of(run)
                ]
            if not by_scene or len(section.scenes) > 1:
                means = section.means(run, common)
                name = f"mean of {_scenes(section, run, common)}"
                rows.append((run, name, *(_cell(means.get(key), mark) for key in keys)))
        header = ("run", "scene" if by_scene else "scenes", *(measure.heading for measure, _ in keys))
        title = f"{section.data_set} - {section.protocol.name}, every measure, {mask}"
        made.append(Table(title, header, tuple(rows)))
    return made


def by_scene(section: Section) -> Table:
    """The headline of every scene: a row a run where there are few, else a row a scene."""
    headline, masks, runs = section.protocol.headline, section.masks, section.runs
    cells = {
        (r.run, r.scene, mask): _cell(r.by_key.get((headline, mask)), "*" * bool(r.error))
        for r in section.results
        for mask in masks
    }
    title = f"{section.data_set} - {headline.heading} by scene"
    if len(section.scenes) <= 4:
        few = [(run, *(" / ".join(cells[run, s, m] for m in masks) for s in section.scenes)) for run in runs]
        return Table(f"{title}: {' / '.join(masks)}", ("run", *map(short, section.scenes)), tuple(few))
    sides = [f"{run}: {m}" if len(runs) > 1 else m for run in runs for m in masks]
    rows = [(short(s), *(cells[run, s, m] for run in runs for m in masks)) for s in section.scenes]
    return Table(title, ("scene", *sides), tuple(rows))


def overview(report: EvaluationReport) -> list[Table]:
    """The one figure of every run in every data set; and over all data sets of a protocol, where it has several."""
    if len(report.sections) < 2:
        return []
    together = [s for s in report.by_protocol if sum(o.protocol is s.protocol for o in report.sections) > 1]
    sections = [*report.sections, *together]
    rows = tuple(
        (run, *(_cell(section.figure(run), "*" * bool(section.lacking(run))) for section in sections))
        for run in report.runs
    )
    titles = [f"{section.data_set} ({section.protocol.name})" for section in sections]
    note = _STAR if any(section.incomplete for section in sections) else ""
    return [Table("Headline by data set", ("run", *titles), rows, note)]


def comparison(report: EvaluationReport) -> list[Table]:
    """Every further run against the first."""
    rows = tuple(
        (
            section.protocol.name,
            run,
            report.runs[0],
            *(str(n) for n in (c.scenes, c.wins, c.losses, c.ties)),
            number(c.mean_difference, 3),
            number(c.worst_ratio, 3),
            f"{c.p_value:.3g}",
        )
        for section, run, c in report.comparisons()
    )
    header = ("protocol", "run", "against", "scenes", "run wins", "other wins", "ties", "mean difference",
              "worst ratio", "p (sign test)")  # fmt: skip
    note = "headline in the main region of the scenes that both have; difference: run - other; ratio: run / other"
    return [Table("Paired comparison", header, rows, note)] if rows else []


def confidence(report: EvaluationReport) -> list[Table]:
    """Areas of the sparsification curves, by scene and as means over the scenes."""
    rows: list[tuple[str, ...]] = []
    groups: dict[tuple[str, str, str, str], list[Curve]] = {}
    for r in report.results:
        for c in r.curves:
            groups.setdefault((r.run, c.mask, c.confidence, c.of), []).append(c)
            rows.append((r.run, r.scene, c.mask, c.confidence, c.of, *_areas([c])))
    for (run, mask, name, of), curves in groups.items():
        if len(curves) > 1:
            rows.append((run, f"mean of {len(curves)}", mask, name, of, *_areas(curves)))
    header = ("run", "scene", "mask", "confidence", "of", "AUC", "optimal", "random", "AUC/optimal", "AUSE", "AURG",
              "AUC 5-100", "optimal 5-100")  # fmt: skip
    note = (
        "sparsification over the estimated pixels, of wrong ones (bad: by the headline's rule) and of the error; AUC: "
        "integral over all shares; random: their mean; AUSE, AURG: distance to optimal and random; 5-100: trapezoid "
        "over 5..100 %, as LAF-Net and the survey of Poggi et al. take it"
    )
    return [Table("Confidence", header, tuple(rows), note)] if rows else []


def short(scene: str) -> str:
    """A scene's name without its data set."""
    return scene.rpartition("/")[2]


def _run_rows(section: Section) -> list[tuple[str, bool, str]]:
    """(run, over the common scenes only, mark of its numbers), in the order of rows."""
    kinds = (False, True) if section.incomplete else (False,)
    return [(run, kind, "" if kind else "*" * bool(section.lacking(run))) for run in section.runs for kind in kinds]


def average_rank(section: Section, keys: Sequence[tuple[Measure, str]]) -> dict[str, float]:
    """Run -> mean rank over the common scenes and (measure, region) pairs; equal values share a rank."""
    grid = [
        [
            (-1 if key[0].larger_is_better else 1) * r.by_key[key].value
            for r in section.of(run, common=True)
            for key in keys
            if key in r.by_key
        ]
        for run in section.runs
    ]
    ranks = average_ranks(np.array(grid, np.float64).reshape(len(section.runs), -1))
    return {run: float(rank) for run, rank in zip(section.runs, ranks, strict=True)}


def _cell(score: Score | None, mark: str = "") -> str:
    return "-" if score is None or math.isnan(score.value) else number(score.value) + mark


def _scenes(section: Section, run: str, common: bool) -> str:
    if common:
        return f"{len(section.common)} common"
    total, lacking = len(section.scenes), section.lacking(run)
    return f"{total}, {lacking} missing*" if lacking else str(total)


def _note(section: Section) -> str:
    return "; ".join(filter(None, [section.protocol.note, _STAR if section.incomplete else ""]))


def _areas(curves: Sequence[Curve]) -> tuple[str, ...]:
    areas = [c.line.areas() for c in curves]
    means = {name: mean(each[name] for each in areas) for name in areas[0]}
    means["ratio"] = means["auc"] / means["optimal"] if means["optimal"] > 0 else math.nan
    return tuple(number(value, 2 if name == "ratio" else 4) for name, value in means.items())


def mean(values: Iterable[float]) -> float:
    """Mean of those that are numbers, NaN of none."""
    present = [v for v in values if not math.isnan(v)]
    return math.fsum(present) / len(present) if present else math.nan
