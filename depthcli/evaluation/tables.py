"""Tables of an evaluation: its records arranged in rows and columns, as narrow tables to be read and as wide ones.

Narrow tables have a row for every run or scene and a column for every metric or region. Wide tables have a row for
every run, a column for every scene or metric, and ranked numbers: they are for papers and for the page.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from depthcli.core.text import one_line
from depthcli.evaluation.comparison import EvaluationReport, Section
from depthcli.evaluation.render import Number, Table, markdown_code, markdown_link, markdown_text
from depthcli.evaluation.results import ConfidenceCurve
from depthcli.evaluation.scores import Key, Score
from depthcli.evaluation.statistics import mean_of_known

_MISSING = "*: scenes without a map count as wholly wrong; where a metric has no worst value there is no mean over all"
_MAX_SCENE_COLUMNS = 4  # of a narrow table; more scenes are its rows


def short(scene: str) -> str:
    """Return a scene's name without its data set."""
    return scene.rpartition("/")[2]


def report_text(report: EvaluationReport) -> str:
    """Return all tables and warnings of an evaluation for a terminal."""
    blocks = [table.text() for table in report_tables(report)]
    if report.warnings:
        blocks.append("".join(f"warning: {one_line(line)}\n" for line in report.warnings))
    return "\n".join(blocks)


def report_markdown(report: EvaluationReport) -> str:
    """Return ``report.md``: all tables and warnings, with links to error pictures and plots."""

    runs = ", ".join(map(markdown_code, report.runs))
    out = ["# Evaluation", "", f"Ground truth: {markdown_code(str(report.truth))}. Runs: {runs}.", ""]
    out += [f"**Warning:** {markdown_text(line)}\n" for line in report.warnings]
    out += [table.markdown() for table in report_tables(report)]
    out += ["## Error pictures", ""]
    shown = ((p.name, p.presentation) for p in report.protocols.values())
    out += [f"{name}: {presentation.legend}.\n" for name, presentation in shown if presentation.error_pictures]
    for r in report.results:
        if not r.error:
            scene = markdown_text(r.scene)
            out += [f"{markdown_text(r.run)}, {scene}:", "", f"![{scene}]({markdown_link(r.picture)})", ""]
            out += [f"![{of}, {region}]({markdown_link(path)})\n" for (region, of), path in r.plots.items()]
    return "\n".join(out)


def report_tables(report: EvaluationReport) -> list[Table]:
    """Return all narrow tables of an evaluation."""
    made = [table for section in report.sections for table in section_tables(section)]
    return made + overview(report) + comparisons(report) + further_tables(report)


def section_tables(section: Section) -> list[Table]:
    """Return the narrow tables of one data set, the summary first."""
    made = [summary(section), *details(section)]
    if len(section.scenes) > 1 and (len(section.runs) > 1 or not section.protocol.presentation.scene_rows):
        made.append(headline_by_scene(section))
    for run in section.runs:
        kept = [result.pooling_data for result in section.results_of(run) if result.pooling_data is not None]
        made += section.protocol.presentation.tables(run, kept) if kept else []
    return made


def summary(section: Section) -> Table:
    """Return the headline of every run by region, its single figure and average rank; means over all scenes.

    Where maps are missing, a second row of a run has the means over the common scenes.
    """
    protocol, headline = section.protocol, section.protocol.headline
    keys = [(headline, region) for region in section.regions]
    ranks = section.average_rank([(headline, region) for region in protocol.figure_regions(section.regions)])
    with_figure = protocol.averages_regions and len(section.regions) > 1
    with_times = any(not math.isnan(result.seconds) for result in section.results)
    rows = []
    for run, common, mark in _mean_rows(section):
        cells: list[str] = [_cell(section, section.mean(run, key, common), mark) for key in keys]
        cells += [_cell(section, section.overall(run, common), mark)] * with_figure
        cells += [Number(ranks[run], 1) if common or not section.incomplete else ""]
        cells += [Number(section.mean(run, keys[0], common).density, 1)]
        cells += [Number(mean_of_known(r.seconds for r in section.results_of(run, common)))] * with_times
        rows.append((run, _n_scenes(section, run, common), *cells))
    header = ["run", "scenes", *section.regions, *["mean of all figures"] * with_figure, "avg rank"]
    header += [f"density {section.regions[0]} %", *["seconds"] * with_times]
    title = f"{section.data_set} - {protocol.presentation.title} ({headline.heading})"
    note = "; ".join(filter(None, [protocol.presentation.note, _MISSING if section.incomplete else ""]))
    return Table(title, tuple(header), tuple(rows), note)


def details(section: Section) -> list[Table]:
    """Return a table of every metric for each region, with a row for every run and scene, or for the means alone."""
    scene_rows = section.protocol.presentation.scene_rows
    made: list[Table] = []
    for region in section.regions:
        keys = [key for key in section.keys if key[1] == region]
        rows = []
        for run, common, mark in _mean_rows(section):
            if scene_rows and not common:
                rows += [
                    (run, short(r.scene) + "*" * bool(r.error), *(_cell(section, r.by_key.get(key)) for key in keys))
                    for r in section.results_of(run)
                ]
            if not scene_rows or len(section.scenes) > 1:
                cells = (_cell(section, section.mean(run, key, common), mark) for key in keys)
                rows.append((run, f"mean of {_n_scenes(section, run, common)}", *cells))
        header = ("run", "scene" if scene_rows else "scenes", *(metric.heading for metric, _ in keys))
        title = f"{section.data_set} - {section.protocol.name}, every metric, {region}"
        made.append(Table(title, header, tuple(rows)))
    return made


def headline_by_scene(section: Section) -> Table:
    """Return the headline of every scene: a row for every run where scenes are few, else one for every scene."""
    headline, regions, runs = section.protocol.headline, section.regions, section.runs
    cells = {
        (r.run, r.scene, region): _cell(section, r.by_key.get((headline, region)), "*" * bool(r.error))
        for r in section.results
        for region in regions
    }
    title = f"{section.data_set} - {headline.heading} by scene"
    if len(section.scenes) <= _MAX_SCENE_COLUMNS:
        by_run = [(run, *(" / ".join(cells[run, s, m] for m in regions) for s in section.scenes)) for run in runs]
        return Table(f"{title}: {' / '.join(regions)}", ("run", *map(short, section.scenes)), tuple(by_run))
    header = [f"{run}: {m}" if len(runs) > 1 else m for run in runs for m in regions]
    rows = [(short(s), *(cells[run, s, m] for run in runs for m in regions)) for s in section.scenes]
    return Table(title, ("scene", *header), tuple(rows))


def overview(report: EvaluationReport) -> list[Table]:
    """Return the single figure of every run in every data set and, where a protocol has several, over all of them."""
    if len(report.sections) < 2:
        return []
    together = [s for s in report.by_protocol if sum(o.protocol is s.protocol for o in report.sections) > 1]
    sections = [*report.sections, *together]
    rows = tuple(
        (run, *(_cell(section, section.overall(run), "*" * bool(section.n_missing(run))) for section in sections))
        for run in report.runs
    )
    titles = [f"{section.data_set} ({section.protocol.name})" for section in sections]
    note = _MISSING if any(section.incomplete for section in sections) else ""
    return [Table("Headline by data set", ("run", *titles), rows, note)]


def comparisons(report: EvaluationReport) -> list[Table]:
    """Return the paired comparison of every further run with the first; no table where there is one run."""
    rows = tuple(
        (
            section.protocol.name,
            run,
            report.runs[0],
            *(str(n) for n in (c.scenes, c.wins, c.losses, c.ties)),
            Number(c.mean_difference, 3),
            Number(c.worst_ratio, 3),
            f"{c.p_value:.3g}",
        )
        for section, run, c in report.comparisons()
    )
    header = ("protocol", "run", "against", "scenes", "run wins", "other wins", "ties", "mean difference",
              "worst ratio", "p (sign test)")  # fmt: skip
    note = "headline in the main region of the scenes that both have; difference: run - other; ratio: run / other"
    return [Table("Paired comparison", header, rows, note)] if rows else []


def further_tables(report: EvaluationReport) -> list[Table]:
    """Return the areas of the sparsification curves, and the maps that are missing; no table where there is none."""
    rows: list[tuple[str, ...]] = []
    groups: dict[tuple[str, str, str, str], list[ConfidenceCurve]] = {}
    for r in report.results:
        for c in r.curves:
            groups.setdefault((r.run, c.region, c.confidence, c.of), []).append(c)
            rows.append((r.run, r.scene, c.region, c.confidence, c.of, *_areas([c])))
    for (run, region, name, of), curves in groups.items():
        if len(curves) > 1:
            rows.append((run, f"mean of {len(curves)}", region, name, of, *_areas(curves)))
    header = ("run", "scene", "mask", "confidence", "of", "AUC", "optimal", "random", "AUC/optimal", "AUSE", "AURG",
              "AUC 5-100", "optimal 5-100")  # fmt: skip
    note = (
        "sparsification over the estimated pixels, of wrong ones (bad: by the headline's rule) and of the error; AUC: "
        "integral over all shares; random: their mean; AUSE, AURG: distance to optimal and random; 5-100: trapezoid "
        "over 5..100 %, as LAF-Net and the survey of Poggi et al. take it"
    )
    failed = tuple((r.run, r.scene, r.error) for r in report.failed)
    made = [
        Table("Confidence", header, tuple(rows), note),
        Table("Not evaluated", ("run", "scene", "reason"), failed),
    ]
    return [table for table in made if table.rows]


def wide_tables(report: EvaluationReport) -> list[Table]:
    """Return the wide tables: of every section the headline by scene, then the means of all metrics, by region."""
    made = []
    for section in report.sections:
        made += [wide_by_scene(section, (section.protocol.headline, region)) for region in section.regions]
        made += [wide_by_metric(section, region) for region in section.regions]
    return made


Column = tuple[str, list[Number], bool | None, str]
"""Heading, number of every run, whether larger is better (None: not ranked), and the scene it speaks of, or empty."""


def wide_by_scene(section: Section, key: Key) -> Table:
    """Return one metric in one region: a column for every scene, then the means and, where they are known, times."""
    metric, region = key
    columns: list[Column] = []
    for scene in section.scenes:
        results = [next(r for r in section.results_of(run) if r.scene == scene) for run in section.runs]
        if any(key in r.by_key for r in results):
            cells = [_cell(section, r.by_key.get(key), "*" * bool(r.error)) for r in results]
            columns.append((short(scene), cells, metric.larger_is_better, scene))
    if len(section.scenes) > 1:
        heading = section.protocol.presentation.mean_heading
        columns.append(_means(section, key, heading))
        if section.common and section.incomplete:
            columns.append(_means(section, key, f"{heading} of {len(section.common)} common", common=True))
        if metric == section.protocol.headline and len(section.runs) > 1:
            ranks = [Number(rank, 1) for rank in section.average_rank([key]).values()]
            columns.append(("avg rank", ranks, False, ""))
    return _wide(section, f"{section.data_set}: {metric.heading_with_unit}, {region}", columns)


def wide_by_metric(section: Section, region: str) -> Table:
    """Return the means over the scenes of every metric in one region, a column for each."""
    columns = [_means(section, key, key[0].heading) for key in section.keys if key[1] == region]
    many = len(section.scenes)
    over = f"means over {many} scenes" if many > 1 else short(section.scenes[0])
    return _wide(section, f"{section.data_set}: {over}, {region}", columns)


def _means(section: Section, key: Key, heading: str, common: bool = False) -> Column:
    cells = [
        _cell(section, section.mean(run, key, each), mark) for run, each, mark in _mean_rows(section) if each == common
    ]
    return heading, cells, key[0].larger_is_better, ""


def _wide(section: Section, title: str, columns: list[Column]) -> Table:
    """Columns as a table, with the mean seconds of a scene, a megapixel, and 10^9 pixels x disparities beside."""
    runs = [section.results_of(run) for run in section.runs]
    times = {
        "seconds": [mean_of_known(r.seconds for r in results) for results in runs],
        "s/MP": [mean_of_known(1e6 * r.seconds / r.size for r in results if r.size) for results in runs],
        "s/GD": [
            mean_of_known(1e9 * r.seconds / (r.size * r.n_disparities) for r in results if r.size and r.n_disparities)
            for results in runs
        ],
    }
    known = {heading: values for heading, values in times.items() if not all(map(math.isnan, values))}
    columns = columns + [(heading, [Number(v) for v in values], False, "") for heading, values in known.items()]
    rows = tuple((run, *(cells[i] for _, cells, _, _ in columns)) for i, run in enumerate(section.runs))
    note = "*: no map, counted as wholly wrong; means over scenes that all runs have beside" * section.incomplete
    return Table(
        title,
        ("run", *(heading for heading, *_ in columns)),
        rows,
        note,
        (None, *(larger for _, _, larger, _ in columns)),
        ("", *(scene for *_, scene in columns)),
    )


def _mean_rows(section: Section) -> list[tuple[str, bool, str]]:
    """(run, over the common scenes alone, mark of its numbers) of every row of means."""
    return [
        (run, common, "*" * bool(not common and section.n_missing(run)))
        for run in section.runs
        for common in ((False, True) if section.incomplete else (False,))
    ]


def _cell(section: Section, score: Score | None, mark: str = "") -> Number:
    return Number(math.nan if score is None else score.value, section.protocol.presentation.digits, mark)


def _n_scenes(section: Section, run: str, common: bool) -> str:
    if common:
        return f"{len(section.common)} common"
    n_missing = section.n_missing(run)
    return f"{len(section.scenes)}, {n_missing} missing*" if n_missing else str(len(section.scenes))


def _areas(curves: Sequence[ConfidenceCurve]) -> tuple[str, ...]:
    areas = [c.line.areas() for c in curves]
    means = {name: mean_of_known(each[name] for each in areas) for name in areas[0]}
    means["ratio"] = means["auc"] / means["optimal"] if means["optimal"] > 0 else math.nan
    return tuple(Number(value, 2 if name == "ratio" else 4) for name, value in means.items())
