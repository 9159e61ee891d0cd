"""The tables of an evaluation: on a terminal, in ``report.md``, for papers (LaTeX, Markdown, CSV) and on the page.

Narrow tables have a row for every run or scene and a column for every metric or region. Wide tables have a row for
every run, a column for every scene or metric, and ranked numbers.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from operator import itemgetter

from depthcli.core.errors import ConfigError
from depthcli.evaluation.bounds import BAD, COVERAGE, COVERING, WORST
from depthcli.evaluation.comparison import EvaluationReport, Section
from depthcli.evaluation.curves import ConfidenceCurve, HiddenPixels, Reliability
from depthcli.evaluation.evaluate import ScoredMap, Viewer
from depthcli.evaluation.scores import COMMON_MEAN, ESTIMATED_ONLY, MEAN, Key
from depthcli.evaluation.statistics import mean_of_known
from depthcli.io.formats.files import write_text
from depthcli.io.formats.images import write_png
from depthcli.report.plots import curve_plot
from depthcli.show.table import FORMATS, Column, Number, Table, markdown_code, markdown_link, markdown_text
from depthcli.show.view import draw_legend, kind_colors

NAMES = ("headline", "overview", "pairs", "metrics", "scenes", "further", "bounds", "confidence", "hidden", "missing")
"""Names of tables, which a region or run and a data set may follow, as in ``metrics-nonocc``."""

MISSING = (
    "*: all pixels of scenes without a map count as incorrect; a metric without a worst value has no mean over all"
)
TEST_COLUMNS = ("wins", "losses", "p (Holm)", "verdict")
"""Headings of the tests against the best run."""

_TESTS_NOTE = "wins, losses: scenes on which"  # beginning of their part of a note, up to its end
_MIN_GAPS = 1.0  # % of the pixels that one run has and another lacks, from which there is a note
_WIDTH = 100  # characters of a line of the headline table


def short(scene: str) -> str:
    """Return a scene's name without its data set."""
    return scene.rpartition("/")[2]


def report_tables(report: EvaluationReport) -> list[Table]:
    """Return all narrow tables of an evaluation."""
    tables = []
    for section in report.sections:
        pairs = [pair_table(section)] if report.with_pairs and len(section.runs) > 1 else []
        tables += _named(report, section, [*section_tables(section), *pairs])
    return overview(report) + tables + further_tables(report)


def _named(report: EvaluationReport, section: Section, tables: Sequence[Table]) -> list[Table]:
    """Return the tables of a section with its data set behind their names, and its protocol, where it takes that."""
    same = [other for other in report.sections if other.data_set == section.data_set]
    parts = [section.data_set] * (len(report.sections) > 1) + [section.protocol.name] * (len(same) > 1)
    return [replace(table, name="-".join([table.name, *parts])) for table in tables]


def section_tables(section: Section) -> list[Table]:
    """Return the narrow tables of one data set: summary, every metric by region, headline by scene, the protocol's."""
    presentation, scenes, headline = section.protocol.presentation, section.scenes, section.protocol.headline
    word, tables = presentation.mean_heading, [summary(section)]
    scene_rows = scenes if presentation.scene_rows else []
    mean_rows = [] if scene_rows and len(scenes) == 1 else section.places
    for region in section.regions:
        keys = [key for key in section.keys if key[1] == region]
        rows = [
            (run, short(place) if place in scenes else f"{word} of {_n_scenes(section, run, place, region)}",
             *(_cell(section, run, place, key) for key in keys))
            for run in section.runs for place in (*scene_rows, *mean_rows)
        ]  # fmt: skip
        header = ("run", "scene" if scene_rows else "scenes", *(metric.heading for metric, _ in keys))
        title = f"{section.data_set} - {section.protocol.name}, every metric, {region}"
        tables.append(Table.of_cells(title, header, rows, name=f"metrics-{region}"))
    if len(scenes) > 1 and (len(section.runs) > 1 or not scene_rows):
        rows = [
            (short(scene), run, *(_cell(section, run, scene, (headline, region)) for region in section.regions))
            for scene in scenes
            for run in section.runs
        ]
        title = f"{section.data_set} - {headline.heading} by scene"
        tables.append(Table.of_cells(title, ("scene", "run", *section.regions), rows, name="scenes"))
    tables += bound_tables(section)
    for run in section.runs:
        kept = [result.pooling_data for result in section.results_of(run) if result.pooling_data is not None]
        for table in presentation.tables(run, kept) if kept else []:
            title = f"{section.data_set} - {table.title} ({len(kept)} scene{'s' * (len(kept) != 1)})"
            tables.append(replace(table, title=title, name=f"further-{run}"))
    return tables


def summary(section: Section) -> Table:
    """Return the summary: headline by region, single figure, average rank, and the test against the best run.

    The best run is the first. If maps are missing, a second row of a run has the means over the common scenes.
    """
    protocol, figures, places = section.protocol, section.figure_regions, section.places
    headline, main, complete = protocol.headline, section.regions[0], len(places) == 1
    with_tests, with_times = len(section.runs) > 1, any(not math.isnan(result.seconds) for result in section.results)
    better, word = headline.larger_is_better if complete else None, protocol.presentation.mean_heading
    ranked = [_region_heading(section, region) for region in section.regions]
    if len(figures) > 1:
        ranked.append(f"{word} of {len(section.scenes) * (len(figures) if word == 'mean' else 1)}")
    header = ["run", "scenes", *ranked, *["avg rank", *TEST_COLUMNS] * with_tests, f"density {main} %"]
    header += ["seconds"] * with_times
    ranks = section.average_rank(section.figure_keys) if with_tests else {}
    rows: list[list[str]] = []
    for run, place in itertools.product(section.ranking.runs, places):
        cells = [_cell(section, run, place, (headline, region)) for region in section.regions]
        if len(figures) > 1:
            cells.append(_number(section, run, place, section.overall(run, place).value))
        rows.append([run, _n_scenes(section, run, place), *cells])
        if with_tests:  # of the last mean of a run
            tests = (Number(ranks[run], 1), *_test(section, run))
            rows[-1] += tests if place == places[-1] else [""] * len(tests)
        rows[-1].append(Number(section.score(run, place, (headline, main)).density, 1))
        if with_times:
            rows[-1].append(Number(mean_of_known(result.seconds for result in section.results_of(run, place))))
    title = f"{section.data_set} - {protocol.presentation.title} ({headline.heading})"
    if len(section.regions) > 1 and with_tests:
        title += f", ranked by {'the mean of ' * (len(figures) > 1)}{', '.join(figures)}"
    note = "; ".join(filter(None, [protocol.presentation.note, "" if complete else MISSING]))
    note = ". ".join(filter(None, [note, _gaps_note(section), _tests_note(section)]))
    orders = dict.fromkeys(ranked, better) | {"seconds": False if complete else None}
    columns = [Column(heading, itemgetter(j), orders.get(heading)) for j, heading in enumerate(header)]
    return Table(title, columns, rows, note, "headline")


def bound_tables(section: Section) -> list[Table]:
    """Return the tables of error bounds: by run and region, and the coverage by scene."""
    means = {run: scores for run, scores in section.bounds.items() if scores}
    if not means:
        return []
    title = f"{section.data_set} - bounds of the error"
    unit = section.protocol.presentation.unit
    columns = {
        "coverage %": (COVERAGE, 1), "worst map %": (WORST, 1), "covering maps %": (COVERING, 1),
        "finite %": ("bound finite", 1), f"median, {unit}": ("bound median", 2),
        "mean/constant": ("bound / constant", 2),
    }  # fmt: skip
    rows, covered, surest = [], [], dict[str, None]()
    for run, scores in means.items():
        maps = [result for result in section.results_of(run) if result.bounds]
        for region in dict.fromkeys(score.region for score in scores):
            # Of one level, and of the last share of BAD.
            by_name = {s.metric.name: s for s in scores if s.region == region}
            cells = [Number(by_name[name].value if name in by_name else math.nan, n) for name, n in columns.values()]
            bad = [s for s in scores if (s.metric.name, s.region) == (BAD, region)]
            surest |= dict.fromkeys(f"bad of {score.metric.threshold:g} %" for score in bad)
            start = (run, str(by_name[COVERING].pixels), region, f"{by_name[COVERAGE].metric.threshold:g}")
            rows.append((*start, *cells, *(Number(score.value) for score in bad)))
        for result in maps:
            shares = {s.region: s.value for s in result.bounds if s.metric.name == COVERAGE}
            covered.append((result.run, short(result.scene), shares))
    note = (
        "over pixels with ground truth and a value; coverage: share of the errors within finite bounds, which "
        "should be the level; finite: share of finite bounds (others are open: the error may exceed the search); "
        "covering maps: maps whose coverage is at least the level minus 10 points; mean/constant: mean finite "
        "bound over the constant bound with the same coverage; bad: incorrect pixels, by the headline's rule, "
        "among the pixels with the smallest bounds; means over the maps; said: by the map's own status"
    )
    regions = list(dict.fromkeys(region for *_, shares in covered for region in shares))
    by_scene = [(run, scene, *(Number(of.get(name, math.nan), 1) for name in regions)) for run, scene, of in covered]
    header = ("run", "maps", "mask", "level %", *columns, *surest)
    tables = [Table.of_cells(title, header, rows, note, "bounds")]
    if len(section.scenes) > 1:
        title = f"{title}, coverage % by scene"
        tables.append(Table.of_cells(title, ("run", "scene", *regions), by_scene, name="bounds-scenes"))
    return tables


def pair_table(section: Section) -> Table:
    """Return the table of significance tests between all pairs of runs of one data set."""
    rows = [
        (b, a, str(test.scenes), str(test.wins), str(test.losses), *("-" if math.isnan(v) else f"{v:.2g}" for v in ps))
        for a, b, test, p in section.pairs
        for ps in [(test.p_value, p)]
    ]
    note = (
        "wins, losses: scenes on which the run's figure is better or worse than the other's; p: Wilcoxon signed-rank "
        f"test over the scenes; p (Holm): corrected for all {len(rows)} pairs"
    )
    header = ("run", "against", "scenes", "wins", "losses", "p", "p (Holm)")
    return Table.of_cells(f"{section.data_set} - all pairs of runs", header, rows, note, "pairs")


def _test(section: Section, run: str) -> tuple[str, str, str, str]:
    """Return the cells of the columns ``TEST_COLUMNS``."""
    ranking = section.ranking
    if run not in ranking.tests:
        return "", "", "", ranking.word(run)
    test, p = ranking.tests[run], ranking.p_values[run]
    return str(test.wins), str(test.losses), "-" if math.isnan(p) else f"{p:.2g}", ranking.word(run)


def _tests_note(section: Section) -> str:
    """Return how the runs were tested, and the results; empty for one run."""
    ranking, figures = section.ranking, section.figure_regions
    if not ranking.tests:
        return ""
    mean = "mean of " * (len(figures) > 1) + ", ".join(figures)
    return (
        f"{_TESTS_NOTE} {section.protocol.headline.heading} ({mean}) is better or worse than the best run's; "
        f"p: Wilcoxon signed-rank test over the scenes, Holm-corrected for {ranking.n_tests} "
        f"test{'s' * (ranking.n_tests != 1)}. {ranking.verdict()}"
    )


def _gaps_note(section: Section) -> str:
    """Return that maps with gaps are not comparable, if gaps cost nothing and differ; otherwise nothing."""
    key = section.protocol.headline, section.regions[0]
    shares = [section.score(run, section.places[-1], key).density for run in section.runs]
    known = [share for share in shares if not math.isnan(share)]
    if not key[0].convention.startswith(ESTIMATED_ONLY) or not known or max(known) - min(known) < _MIN_GAPS:
        return ""
    return (
        f"Each run is scored where it has values, {min(known):.1f} to {max(known):.1f} % of the pixels: gaps are not "
        "counted, and are often where the others are worst"
    )


def _region_heading(section: Section, region: str) -> str:
    """Return the name of a region, with the number of scenes that its mean is over where some lack it."""
    n = len(section.known[region])
    return region if n == len(section.scenes) else f"{region} ({n} of {len(section.scenes)})"


def overview(report: EvaluationReport) -> list[Table]:
    """Return the single figure of every run in every data set if there are several; no figure is over all data sets."""
    if len(report.sections) < 2:
        return []
    header = ["data set", "protocol", "metric", "regions", "run", "scenes", "figure"]
    cells = [
        (
            section.data_set,
            section.protocol.name,
            section.protocol.headline.heading_with_unit,
            ", ".join(section.figure_regions),
            run,
            _n_scenes(section, run, MEAN, section.figure_regions[0]),
            _number(section, run, MEAN, section.overall(run).value),
            *_test(section, run),
        )
        for section in report.sections
        for run in section.ranking.runs
    ]
    note = [MISSING] * any(len(section.places) > 1 for section in report.sections)
    if len(report.runs) > 1:
        header += TEST_COLUMNS
        note.append(
            f"{_TESTS_NOTE} the run's figure is better or worse than the figure of the data set's first, the "
            "best; p: Wilcoxon signed-rank test over the scenes, Holm-corrected within a data set"
        )
    return [Table.of_cells("Headline by data set", header, cells, ". ".join(note), "overview")]


def further_tables(report: EvaluationReport) -> list[Table]:
    """Return the tables of areas of sparsification curves, of hidden pixels, and of missing maps; none without rows."""
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
            of = f" of {len(curves)}" + f" of {data_set}" * several
            rows.append((run, f"mean{of}", *what, *_areas(curves)[:-1], "-"))
            if (ece := _areas(curves)[-1]) != "-":
                rows.append((run, f"pooled{of}", *what, *["-"] * 8, ece))
    for (data_set, run), group in pooled.items():
        if len(group) > 1:
            shares = (Number(value, 1) for value in HiddenPixels.pooled(group).shares().values())
            hidden.append((run, f"pooled of {len(group)}" + f" of {data_set}" * several, *shares))
    areas = ("AUC", "optimal", "random", "AUC/optimal", "AUSE", "AURG", "AUC 5-100", "optimal 5-100", "ECE")
    note = (
        "sparsification curves over pixels with a value, of incorrect pixels (bad, by the headline's rule) and of "
        "the error; AUC: integral over all shares; random: AUC of a random order; AUSE, AURG: distance of AUC from"
        " optimal and random; 5-100: trapezoid over 5..100 %, as in LAF-Net and the survey of Poggi et al.; ECE: "
        "expected calibration error, if the confidence is a probability; mean: of the maps' areas, and for "
        "AUC/optimal the ratio of these; pooled: over all pixels together"
    )
    hidden_note = (
        "pixels that the right view does not see: by status.png (occluded, or out of range), compared with the ground "
        "truth (in all, not in nonocc), percent"
    )
    shares_of = ("precision", "recall", "F1", "said hidden %", "truly hidden %")
    failed = [(r.run, r.scene, r.error) for r in report.failed]
    tables = [
        Table.of_cells("Confidence", ("run", "scene", "mask", "confidence", "of", *areas), rows, note, "confidence"),
        Table.of_cells("Hidden pixels", ("run", "scene", *shares_of), hidden, hidden_note, "hidden"),
        Table.of_cells("Not evaluated", ("run", "scene", "reason"), failed, name="missing"),
    ]
    return [table for table in tables if table.rows]


def _areas(curves: Sequence[ConfidenceCurve]) -> list[Number]:
    """Return the mean areas of curves, and the calibration error of all pixels together."""
    areas = [c.areas for c in curves]
    means = {name: mean_of_known(area[name] for area in areas) for name in areas[0]}
    known = [c.reliability for c in curves if c.reliability is not None]
    means["ece"] = Reliability.pooled(known).ece if known else math.nan
    means["ratio"] = means["auc"] / means["optimal"] if means["optimal"] > 0 else math.nan
    return [Number(value, 2 if name == "ratio" else 4) for name, value in means.items()]


def _cell(section: Section, run: str, place: str, key: Key) -> Number:
    return _number(section, run, place, section.score(run, place, key).value)


def _number(section: Section, run: str, place: str, value: float) -> Number:
    """Return a score of a scene, or a mean, as a cell; marked where that scene, or one of the mean's, has no map."""
    missing = section.missing[run]
    marked = place in missing or (place == MEAN and missing)
    return Number(value, section.protocol.presentation.digits, "*" * bool(marked))


def _n_scenes(section: Section, run: str, place: str, region: str | None = None) -> str:
    """Return the number of scenes that a run's mean is over: of all, or of those with truth in a region."""
    counts = section.counts(run, region)
    if place == COMMON_MEAN:
        return f"{counts['common']} common"
    return f"{counts['scenes']}, {counts['missing']} missing*" if counts["missing"] else str(counts["scenes"])


def wide_by_scene(section: Section, key: Key) -> Table:
    """Return one metric in one region: a column for every scene, then means and, if known, times."""
    metric, region = key
    places = [s for s in section.scenes if any(key in section.scores[run, s] for run in section.runs)]
    columns = [(short(scene), scene, key) for scene in places]
    if len(section.scenes) > 1:
        heading, known = section.protocol.presentation.mean_heading, section.known[region]
        for place in section.places:
            if place == COMMON_MEAN and section.common:
                columns.append((f"{heading} of {len(known & section.common)} common", place, key))
            elif place == MEAN:
                columns.append((f"{heading} of {len(known)}", place, key))
    ranked = len(section.scenes) > 1 and metric == section.protocol.headline and len(section.runs) > 1
    title = f"{section.data_set}: {metric.heading_with_unit}, {region}"
    return _wide(section, title, f"scenes-{region}", columns, ranked)


def _wide_by_metric(section: Section, region: str) -> Table:
    """Return the means of all metrics in one region: a column for every metric, and times."""
    columns = [(key[0].heading, MEAN, key) for key in section.keys if key[1] == region]
    known = section.known[region]
    word = section.protocol.presentation.mean_heading
    over = f"{word} of {len(known)} scenes" if len(known) > 1 else ", ".join(map(short, known))
    return _wide(section, f"{section.data_set}: {over}, {region}", f"metrics-{region}", columns)


def _wide(
    section: Section,
    title: str,
    name: str,
    columns: Sequence[tuple[str, str, Key]],
    ranked: bool = False,
) -> Table:
    """Return scores by run, the columns being (heading, scene or mean, key), with times, and ranks of the first key.

    Times are the mean seconds of a scene, of a megapixel, and of 10^9 pixels x disparities.
    """
    all_columns = [Column("run", str)]
    for heading, place, key in columns:
        scene = place if place in section.scenes else ""
        cell = partial(_cell, section, place=place, key=key)
        all_columns.append(Column(heading, cell, key[0].larger_is_better, scene))
    if ranked:
        ranks = section.average_rank([columns[0][2]])
        all_columns.append(Column("avg rank", lambda run: Number(ranks[run], 1), False))
    for heading in ("seconds", "s/MP", "s/GD"):
        cells = {run: Number(mean_of_known(r.times[heading] for r in section.results_of(run))) for run in section.runs}
        if any(cell != "-" for cell in cells.values()):
            all_columns.append(Column(heading, cells.__getitem__, False))
    note = "*: no map, all pixels count as incorrect; see the means over scenes that all runs have"
    return Table(title, all_columns, section.runs, note * (len(section.places) > 1), name)


def headline_text(report: EvaluationReport) -> str:
    """Return the headline for a terminal, at most 100 columns wide: by region, or by data set if there are several."""
    if len(report.sections) == 1:
        (section,) = report.sections
        table = summary(section)
        spare = ["avg rank", f"density {section.regions[0]} %", "seconds"]
        spare += [_region_heading(section, region) for region in section.regions[:0:-1]]
        note = ". ".join(filter(None, [MISSING * (len(section.places) > 1), _gaps_note(section), _tests_note(section)]))
        text = replace(table, note=note).fitted(_WIDTH, spare, ["run"]).text(_WIDTH)
        return text + (f"\n{pair_table(section).text(_WIDTH)}" if report.with_pairs and len(section.runs) > 1 else "")
    spare, names = ["protocol", "losses", "regions"], ["data set", "run"]
    return "".join(table.fitted(_WIDTH, spare, names).text(_WIDTH) for table in overview(report))


def chosen_text(
    report: EvaluationReport,
    names: Sequence[str],
    columns: Sequence[str] = (),
    form: str | None = None,
    caption: str | None = None,
) -> str:
    """Return tables for a terminal, or in a format. Raise ConfigError for unknown tables, or one caption for several.

    Parameters
    ----------
    names : names of tables, or their beginnings up to a dash; ``all``: all. Empty: all wide tables of the format
    columns : headings of the columns to show, in addition to the first one and ``run``; empty: all
    form : one of ``FORMATS``, in which tables of scenes and metrics are wide; None: aligned text, wrapped
    caption : title that replaces the table's title
    """
    tables = report_tables(report)
    if form is not None:
        others = [table for table in tables if table.name.partition("-")[0] not in ("scenes", "metrics")]
        tables = []
        for section in report.sections:
            wide = [wide_by_scene(section, (section.protocol.headline, region)) for region in section.regions]
            wide += [_wide_by_metric(section, region) for region in section.regions]
            tables += _named(report, section, wide)
        tables += others if names else []
    if names:
        called = {name: [t for t in tables if name == "all" or f"{t.name}-".startswith(f"{name}-")] for name in names}
        if absent := [name for name, matches in called.items() if not matches and name not in ("all", *NAMES)]:
            raise ConfigError(f"--tables: no table {absent[0]}; there are {', '.join(t.name for t in tables)}")
        tables = [table for table in tables if any(table in matches for matches in called.values())]
    if columns:
        known = dict.fromkeys(heading for table in tables for heading in table.header[1:])
        if absent := [name for name in columns if name not in known]:
            raise ConfigError(f"--columns: no {', '.join(absent)} in these tables, which have {', '.join(known)}")
        tables = [table.only([*columns, "run"]) for table in tables if set(columns) & set(table.header[1:])]
        if not set(columns) & set(TEST_COLUMNS):
            tables = [replace(table, note=table.note.partition(_TESTS_NOTE)[0].rstrip(". ")) for table in tables]
    if caption is not None:
        if len(tables) != 1:
            raise ConfigError(f"--caption: is for one table; give --tables {' or '.join(t.name for t in tables)}")
        tables = [replace(tables[0], title=caption)]
    return "\n".join(table.text(_WIDTH) for table in tables) if form is None else FORMATS[form](tables)


class Document(Viewer):
    """Tables as Markdown, and plots of confidence curves as SVG."""

    file = "report.md"
    needed = True

    def add_map(self, scored: ScoredMap) -> None:
        result = scored.result
        for (region, of), plot in result.plots.items():
            lines = {c.confidence: c.line for c in result.curves if (c.region, c.of) == (region, of)}
            write_text(self.folder / plot, curve_plot(lines, f"{result.run}: {result.scene}, {region}", of))

    def write(self, report: EvaluationReport, scores: str, configs: Mapping[str, str]) -> None:
        """Write ``report.md``, and legends of the error pictures."""
        write_text(self.folder / self.file, _markdown(report))
        drawn = [protocol for protocol in report.protocols.values() if protocol.presentation.error_pictures]
        for protocol in drawn if any(not result.error for result in report.results) else []:
            names = protocol.presentation.pixel_kind_names
            legend = draw_legend(zip(names, kind_colors().tolist(), strict=True))
            which = f"_{protocol.name}" if len(drawn) > 1 else ""
            write_png(self.folder / "errors" / f"legend{which}.png", legend)


def _markdown(report: EvaluationReport) -> str:
    """Return all tables and warnings, with links to error pictures and plots."""
    runs = ", ".join(map(markdown_code, report.runs))
    out = ["# Evaluation", "", f"Ground truth: {markdown_code(report.truth)}. Runs: {runs}.", ""]
    if report.plugins:
        used = ", ".join(f"{package} {version}" for package, version in report.plugins.items())
        out += [f"Plug-ins: {markdown_code(used)}.", ""]
    out += [f"**Warning:** {markdown_text(line)}\n" for line in report.warnings()]
    out += [table.markdown() for table in report_tables(report)]
    drawn = {p.name: p.presentation.legend for p in report.protocols.values() if p.presentation.error_pictures}
    out += ["## Error pictures" if drawn else "## Curves", ""]
    out += [f"{name}: {legend}.\n" for name, legend in drawn.items()]
    if drawn and any(r.bounds for r in report.results):
        out += ["Pictures of bounds, below, show errors beyond the bound in the colors of incorrect pixels.\n"]
    for r in report.results:
        if not r.error:
            scene = markdown_text(r.scene)
            out += [f"{markdown_text(r.run)}, {scene}:", ""]
            out += [f"![{scene}]({markdown_link(r.picture)})", ""] if r.protocol in drawn else []
            out += [f"![bound]({markdown_link(r.bound_picture)})", ""] if r.protocol in drawn and r.bounds else []
            out += [f"![{of}, {region}]({markdown_link(path)})\n" for (region, of), path in r.plots.items()]
    return "\n".join(out)
