"""The tables of an evaluation: on a terminal, in ``report.md``, for papers (LaTeX, Markdown, CSV) and on the page.

Narrow tables have a row for every run or scene and a column for every metric or region. Wide ones have a row for every
run, a column for every scene or metric, and ranked numbers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from depthcli.core.errors import ConfigError
from depthcli.evaluation.comparison import EvaluationReport, Section
from depthcli.evaluation.curves import ConfidenceCurve, HiddenPixels, Reliability
from depthcli.evaluation.render import FORMATS, Number, Table, markdown_code, markdown_link, markdown_text
from depthcli.evaluation.scores import Key, Score
from depthcli.evaluation.statistics import mean_of_known

NAMES = ("headline", "overview", "metrics", "scenes", "further", "confidence", "hidden", "missing")
"""Names of tables; behind them may stand a region or run and a data set, as in ``metrics-nonocc``."""

MISSING = "*: scenes without a map count as wholly wrong; where a metric has no worst value there is no mean over all"
TEST_COLUMNS = ("wins", "losses", "p (Holm)", "verdict")
"""Headings of what the tests against the best run say."""

_TESTS_NOTE = "wins, losses: scenes on which"  # beginning of what a note says of them, up to its end
_WIDTH = 100  # characters of a line of the headline table
_MAX_SCENE_COLUMNS = 4  # of a narrow table; more scenes are its rows


def short(scene: str) -> str:
    """Return a scene's name without its data set."""
    return scene.rpartition("/")[2]


def report_tables(report: EvaluationReport) -> list[Table]:
    """Return all narrow tables of an evaluation."""
    made = [table for section in report.sections for table in named(report, section, section_tables(section))]
    return overview(report) + made + further_tables(report)


def named(report: EvaluationReport, section: Section, tables: Sequence[Table]) -> list[Table]:
    """Return the tables of a section with its data set behind their names, and its protocol, where it takes that."""
    same = [other for other in report.sections if other.data_set == section.data_set]
    parts = [section.data_set] * (len(report.sections) > 1) + [section.protocol.name] * (len(same) > 1)
    return [replace(table, name="-".join([table.name, *parts])) for table in tables]


def section_tables(section: Section) -> list[Table]:
    """Return the narrow tables of one data set, the summary first."""
    made = [summary(section), *details(section)]
    if len(section.scenes) > 1 and (len(section.runs) > 1 or not section.protocol.presentation.scene_rows):
        made.append(headline_by_scene(section))
    for run in section.runs:
        kept = [result.pooling_data for result in section.results_of(run) if result.pooling_data is not None]
        for table in section.protocol.presentation.tables(run, kept) if kept else []:
            title = f"{section.data_set} - {table.title} ({len(kept)} scene{'s' * (len(kept) != 1)})"
            made.append(replace(table, title=title, name=f"further-{run}"))
    return made


def summary(section: Section) -> Table:
    """Return the headline by region, the single figure, average rank, and the test against the best run.

    The best run is the first. Where maps are missing, a second row of a run has the means over the common scenes.
    """
    protocol, headline = section.protocol, section.protocol.headline
    keys = [(headline, region) for region in section.regions]
    figures = section.figure_regions
    ranks = section.average_rank([(headline, region) for region in figures])
    with_figure, with_tests = len(figures) > 1, len(section.runs) > 1
    with_times = any(not math.isnan(result.seconds) for result in section.results)
    rows = []
    for run, common, mark in mean_rows(section, section.ranking.runs):
        last = common or not section.incomplete
        cells: list[str] = [cell_of(section, section.mean(run, key, common), mark) for key in keys]
        cells += [cell_of(section, section.overall(run, common), mark)] * with_figure
        if with_tests:
            cells += [Number(ranks[run], 1), *_test(section, run)] if last else [""] * (1 + len(TEST_COLUMNS))
        cells += [Number(section.mean(run, keys[0], common).density, 1)]
        cells += [Number(mean_of_known(r.seconds for r in section.results_of(run, common)))] * with_times
        rows.append((run, _n_scenes(section, run, common), *cells))
    n_figures = len(section.scenes) * len(figures)
    header = ["run", "scenes", *(region_heading(section, region) for region in section.regions)]
    header += [f"mean of {n_figures}"] * with_figure + ["avg rank", *TEST_COLUMNS] * with_tests
    header += [f"density {section.regions[0]} %", *["seconds"] * with_times]
    title = f"{section.data_set} - {protocol.presentation.title} ({headline.heading})"
    if len(section.regions) > 1 and with_tests:
        title += f", ranked by {'the mean of ' * with_figure}{', '.join(figures)}"
    note = "; ".join(filter(None, [protocol.presentation.note, MISSING if section.incomplete else ""]))
    better = dict.fromkeys(header[2 : 2 + len(keys) + with_figure], headline.larger_is_better)
    ranked = () if section.incomplete else tuple(better.get(heading) for heading in header)
    return Table(
        title, tuple(header), tuple(rows), ". ".join(filter(None, [note, tests_note(section)])), ranked, (), "headline"
    )


def _test(section: Section, run: str) -> tuple[str, str, str, str]:
    """Cells of the columns ``TEST_COLUMNS``."""
    ranking = section.ranking
    if run not in ranking.tests:
        return "", "", "", ranking.word(run)
    test, p = ranking.tests[run], ranking.p_values[run]
    return str(test.wins), str(test.losses), "-" if math.isnan(p) else f"{p:.2g}", ranking.word(run)


def tests_note(section: Section) -> str:
    """Return how the runs were tested, and what came out; empty where there is one run."""
    ranking, figures = section.ranking, section.figure_regions
    if not ranking.tests:
        return ""
    mean = "mean of " * (len(figures) > 1) + ", ".join(figures)
    return (
        f"{_TESTS_NOTE} {section.protocol.headline.heading} ({mean}) is better or worse than the best run's; "
        f"p: Wilcoxon signed-rank test over the scenes, Holm-corrected for {ranking.n_tests} "
        f"test{'s' * (ranking.n_tests != 1)}. {ranking.verdict()}"
    )


def region_heading(section: Section, region: str) -> str:
    """Return the name of a region, with the number of scenes that its mean is over where some lack it."""
    n = len(section.scenes_with(region))
    return region if n == len(section.scenes) else f"{region} ({n} of {len(section.scenes)})"


def details(section: Section) -> list[Table]:
    """Return a table of every metric for each region, with a row for every run and scene, or for the means alone."""
    scene_rows = section.protocol.presentation.scene_rows
    made: list[Table] = []
    for region in section.regions:
        keys = [key for key in section.keys if key[1] == region]
        rows = []
        for run, common, mark in mean_rows(section):
            if scene_rows and not common:
                rows += [
                    (run, short(r.scene) + "*" * bool(r.error), *(cell_of(section, r.by_key.get(key)) for key in keys))
                    for r in section.results_of(run)
                ]
            if not scene_rows or len(section.scenes) > 1:
                cells = (cell_of(section, section.mean(run, key, common), mark) for key in keys)
                rows.append((run, f"mean of {_n_scenes(section, run, common, region)}", *cells))
        header = ("run", "scene" if scene_rows else "scenes", *(metric.heading for metric, _ in keys))
        title = f"{section.data_set} - {section.protocol.name}, every metric, {region}"
        made.append(Table(title, header, tuple(rows), name=f"metrics-{region}"))
    return made


def headline_by_scene(section: Section) -> Table:
    """Return the headline of every scene: a row for every run where scenes are few, else one for every scene."""
    headline, regions, runs = section.protocol.headline, section.regions, section.runs
    cells = {
        (r.run, r.scene, region): cell_of(section, r.by_key.get((headline, region)), "*" * bool(r.error))
        for r in section.results
        for region in regions
    }
    title = f"{section.data_set} - {headline.heading} by scene"
    if len(section.scenes) <= _MAX_SCENE_COLUMNS:
        by_run = [(run, *(" / ".join(cells[run, s, m] for m in regions) for s in section.scenes)) for run in runs]
        scenes = ("run", *map(short, section.scenes))
        return Table(f"{title}: {' / '.join(regions)}", scenes, tuple(by_run), name="scenes")
    header = [f"{run}: {m}" if len(runs) > 1 else m for run in runs for m in regions]
    rows = [(short(s), *(cells[run, s, m] for run in runs for m in regions)) for s in section.scenes]
    return Table(title, ("scene", *header), tuple(rows), name="scenes")


def overview(report: EvaluationReport) -> list[Table]:
    """Return the single figure of every run in every data set, where there are several; none is over all of them."""
    if len(report.sections) < 2:
        return []
    rows = []
    for section in report.sections:
        where = (section.data_set, section.protocol.name)
        what = section.protocol.headline.heading_with_unit
        for run in section.ranking.runs:
            figure = cell_of(section, section.overall(run), "*" * bool(section.n_missing(run)))
            test = _test(section, run) if len(report.runs) > 1 else ()
            n_scenes = _n_scenes(section, run, False, section.figure_regions[0])
            rows.append((*where, what, ", ".join(section.figure_regions), run, n_scenes, figure, *test))
    header: tuple[str, ...] = ("data set", "protocol", "metric", "mean of", "run", "scenes", "figure")
    note = [MISSING] * any(section.incomplete for section in report.sections)
    if len(report.runs) > 1:
        header += TEST_COLUMNS
        note.append(
            f"{_TESTS_NOTE} the run's figure is better or worse than that of the data set's first, the "
            "best; p: Wilcoxon signed-rank test over the scenes, Holm-corrected within a data set"
        )
    return [Table("Headline by data set", header, tuple(rows), ". ".join(note), name="overview")]


def further_tables(report: EvaluationReport) -> list[Table]:
    """Return areas of sparsification curves, hidden pixels, and the maps that are missing; no table without rows."""
    rows: list[tuple[str, ...]] = []
    hidden: list[tuple[str, ...]] = []
    groups: dict[tuple[str, ...], list[ConfidenceCurve]] = {}
    pooled: dict[tuple[str, str], list[HiddenPixels]] = {}
    for r in report.results:
        for c in r.curves:
            groups.setdefault((r.data_set, r.protocol, r.run, c.region, c.confidence, c.of), []).append(c)
            rows.append((r.run, r.scene, c.region, c.confidence, c.of, *_areas([c])))
        if r.hidden is not None:
            pooled.setdefault((r.data_set, r.run), []).append(r.hidden)
            hidden.append((r.run, r.scene, *(Number(value, 1) for value in r.hidden.shares().values())))
    several = len(report.sections) > 1
    for (data_set, _, run, *what), curves in groups.items():
        if len(curves) > 1:
            rows.append((run, f"mean of {len(curves)}" + f" of {data_set}" * several, *what, *_areas(curves)))
    for (data_set, run), found in pooled.items():
        if len(found) > 1:
            shares = (Number(value, 1) for value in HiddenPixels.pooled(found).shares().values())
            hidden.append((run, f"pooled of {len(found)}" + f" of {data_set}" * several, *shares))
    areas = ("AUC", "optimal", "random", "AUC/optimal", "AUSE", "AURG", "AUC 5-100", "optimal 5-100", "ECE")
    note = (
        "sparsification over the estimated pixels, of wrong ones (bad: by the headline's rule) and of the error; AUC: "
        "integral over all shares; random: their mean; AUSE, AURG: distance to optimal and random; 5-100: trapezoid "
        "over 5..100 %, as LAF-Net and the survey of Poggi et al. take it; ECE: expected calibration error, where the "
        "confidence is a probability; a mean's is that of all pixels together"
    )
    hidden_note = (
        "pixels that the right view does not see, by status.png (occluded, or out of view) against the truth (in all, "
        "not in nonocc), percent"
    )
    shares_of = ("precision", "recall", "F1", "said hidden %", "truly hidden %")
    failed = tuple((r.run, r.scene, r.error) for r in report.failed)
    curve_columns = ("run", "scene", "mask", "confidence", "of", *areas)
    made = [
        Table("Confidence", curve_columns, tuple(rows), note, name="confidence"),
        Table("Hidden pixels", ("run", "scene", *shares_of), tuple(hidden), hidden_note, name="hidden"),
        Table("Not evaluated", ("run", "scene", "reason"), failed, name="missing"),
    ]
    return [table for table in made if table.rows]


def mean_rows(section: Section, runs: Sequence[str] = ()) -> list[tuple[str, bool, str]]:
    """(run, over the common scenes alone, mark of its numbers) of every row of means, of the runs given or all."""
    return [
        (run, common, "*" * bool(not common and section.n_missing(run)))
        for run in runs or section.runs
        for common in ((False, True) if section.incomplete else (False,))
    ]


def cell_of(section: Section, score: Score | None, mark: str = "") -> Number:
    """Return a score as the cell of a table, ``-`` where there is none."""
    return Number(math.nan if score is None else score.value, section.protocol.presentation.digits, mark)


def _n_scenes(section: Section, run: str, common: bool, region: str | None = None) -> str:
    """Number of scenes that a run's mean is over: of all, or of those with truth in a region."""
    scenes = frozenset(section.scenes) if region is None else section.scenes_with(region)
    if common:
        return f"{len(scenes & section.common)} common"
    n_missing = section.n_missing(run, region)
    return f"{len(scenes)}, {n_missing} missing*" if n_missing else str(len(scenes))


def _areas(curves: Sequence[ConfidenceCurve]) -> tuple[str, ...]:
    areas = [c.areas for c in curves]
    means = {name: mean_of_known(each[name] for each in areas) for name in areas[0]}
    known = [c.reliability for c in curves if c.reliability is not None]
    means["ece"] = Reliability.pooled(known).ece if known else math.nan
    means["ratio"] = means["auc"] / means["optimal"] if means["optimal"] > 0 else math.nan
    return tuple(Number(value, 2 if name == "ratio" else 4) for name, value in means.items())


Column = tuple[str, list[Number], bool | None, str]
"""Heading, number of every run, whether larger is better (None: not ranked), and the scene it speaks of, or empty."""


def wide_by_scene(section: Section, key: Key) -> Table:
    """Return one metric in one region: a column for every scene, then the means and, where they are known, times."""
    metric, region = key
    columns: list[Column] = []
    for scene in section.scenes:
        results = [next(r for r in section.results_of(run) if r.scene == scene) for run in section.runs]
        if any(key in r.by_key for r in results):
            cells = [cell_of(section, r.by_key.get(key), "*" * bool(r.error)) for r in results]
            columns.append((short(scene), cells, metric.larger_is_better, scene))
    if len(section.scenes) > 1:
        heading = section.protocol.presentation.mean_heading
        columns.append(_means(section, key, f"{heading} of {len(section.scenes_with(region))}"))
        if section.common and section.incomplete:
            n_common = len(section.scenes_with(region, common=True))
            columns.append(_means(section, key, f"{heading} of {n_common} common", common=True))
        if metric == section.protocol.headline and len(section.runs) > 1:
            ranks = [Number(rank, 1) for rank in section.average_rank([key]).values()]
            columns.append(("avg rank", ranks, False, ""))
    return _wide(section, f"{section.data_set}: {metric.heading_with_unit}, {region}", columns, f"scenes-{region}")


def _means(section: Section, key: Key, heading: str, common: bool = False) -> Column:
    cells = [
        cell_of(section, section.mean(run, key, each), mark) for run, each, mark in mean_rows(section) if each == common
    ]
    return heading, cells, key[0].larger_is_better, ""


def _wide(section: Section, title: str, columns: list[Column], name: str) -> Table:
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
    headings, _, better, scenes = zip(*columns, strict=True)
    return Table(title, ("run", *headings), rows, note, (None, *better), ("", *scenes), name)


def headline_text(report: EvaluationReport) -> str:
    """Return the headline for a terminal, at most 100 columns wide: of one data set by region, of several by set."""
    if len(report.sections) == 1:
        (section,) = report.sections
        table = summary(section)
        spare = ["avg rank", f"density {section.regions[0]} %", "seconds"]
        spare += [region_heading(section, region) for region in section.regions[:0:-1]]
        note = ". ".join(filter(None, [MISSING * section.incomplete, tests_note(section)]))
        return replace(table, note=note).fitted(_WIDTH, spare, ["run"]).text(_WIDTH)
    fitted = (each.fitted(_WIDTH, ["protocol", "losses", "mean of"], ["data set", "run"]) for each in overview(report))
    return "".join(table.text(_WIDTH) for table in fitted)


def chosen_text(
    report: EvaluationReport,
    names: Sequence[str],
    columns: Sequence[str] = (),
    form: str | None = None,
    caption: str | None = None,
) -> str:
    """Return tables for a terminal, or in a format.

    Parameters
    ----------
    names : names of tables, or their beginnings up to a dash; ``all``: all. Empty: all of a format are the wide ones
    columns : headings of the columns to show beside the first one; empty: all
    form : name of one of ``FORMATS``, in which tables of scenes and metrics are wide; None: aligned text, titles and
        notes wrapped
    caption : title in place of the table's own

    Raises
    ------
    ConfigError
        There is no such table or column, or a caption for several tables.
    """
    narrow = report_tables(report)
    if form is None:
        tables = narrow
    else:
        tables = []
        for section in report.sections:  # the headline by scene, then the means of all metrics, by region
            wide = [wide_by_scene(section, (section.protocol.headline, region)) for region in section.regions]
            for region in section.regions:
                columns_of = [_means(section, key, key[0].heading) for key in section.keys if key[1] == region]
                many = len(section.scenes_with(region))
                over = f"means over {many} scenes" if many > 1 else ", ".join(map(short, section.scenes_with(region)))
                title = f"{section.data_set}: {over}, {region}"
                wide.append(_wide(section, title, columns_of, f"metrics-{region}"))
            tables += named(report, section, wide)
        tables += [t for t in narrow if t.name.partition("-")[0] not in ("scenes", "metrics")] if names else []
    chosen = tables
    if names:
        for name in names:
            if name not in ("all", *NAMES) and not any(_called(table, name) for table in tables):
                raise ConfigError(f"--tables: no table {name}; there are {', '.join(t.name for t in tables)}")
        chosen = [t for t in tables if "all" in names or any(_called(t, name) for name in names)]
    if columns:
        known = dict.fromkeys(heading for table in chosen for heading in table.header[1:])
        if absent := [name for name in columns if name not in known]:
            raise ConfigError(f"--columns: no {', '.join(absent)} in these tables, which have {', '.join(known)}")
        chosen = [table.only(columns) for table in chosen if set(columns) & set(table.header[1:])]
        if not set(columns) & set(TEST_COLUMNS):
            chosen = [replace(table, note=table.note.partition(_TESTS_NOTE)[0].rstrip(". ")) for table in chosen]
    if caption is not None:
        if len(chosen) != 1:
            raise ConfigError(f"--caption: is for one table; give --tables {' or '.join(t.name for t in chosen)}")
        chosen = [replace(table, title=caption) for table in chosen]
    return "\n".join(table.text(_WIDTH) if form is None else FORMATS[form](table) for table in chosen)


def _called(table: Table, name: str) -> bool:
    return f"{table.name}-".startswith(f"{name}-")


def check_names(names: Sequence[str]) -> None:
    """Raise ConfigError where a name can be that of no table."""
    wrong = [name for name in names if name.partition("-")[0] not in (*NAMES, "all")]
    if wrong:
        raise ConfigError(f"--tables: expected all, {', '.join(NAMES)} (got {', '.join(wrong)})")


def report_markdown(report: EvaluationReport) -> str:
    """Return ``report.md``: all tables and warnings, with links to error pictures and plots."""
    runs = ", ".join(map(markdown_code, report.runs))
    out = ["# Evaluation", "", f"Ground truth: {markdown_code(report.truth)}. Runs: {runs}.", ""]
    if report.plugins:
        used = ", ".join(f"{package} {version}" for package, version in report.plugins.items())
        out += [f"Plug-ins: {markdown_code(used)}.", ""]
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
