"""The evaluation of a run or of several, from options to tables and page."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from depthcli.commands._options import RunOptions, SceneOptions, TableOptions, parse_bytes
from depthcli.core.errors import ConfigError
from depthcli.core.text import summarized
from depthcli.evaluation.comparison import EvaluationReport
from depthcli.evaluation.evaluate import PAGE_FILE, RESULTS, Choices, Viewer, can_be_missed, evaluate_runs
from depthcli.evaluation.map_files import run_names
from depthcli.evaluation.protocols import load
from depthcli.io.formats.files import RUN_FILE
from depthcli.io.scenes import Scene, SequenceScene
from depthcli.io.scenes.places import local, origin
from depthcli.problems.problem import SceneJob
from depthcli.report.contact_sheet import ContactSheet
from depthcli.report.page import Page
from depthcli.report.tables import NAMES, Document, chosen_text, headline_text
from depthcli.report.without_truth import RunWithoutTruth
from depthcli.run.console import Reporter
from depthcli.run.flags import Flags, flag_rows
from depthcli.run.folder import EVALUATION, staging_folder
from depthcli.run.job import SceneT
from depthcli.run.records import read_text
from depthcli.show.table import FORMATS, Row


def evaluated(
    job: SceneJob[SceneT],
    scenes: Sequence[SceneT],
    rows: Sequence[Row],
    options: RunOptions,
    source: SceneOptions | None,
    html: bool,
) -> EvaluationReport:
    """Compare scenes with their ground truth; ``html`` writes the page, which shows scenes without truth, too."""
    reporter, conditions = options.reporter, options.conditions
    output, truth = options.output / EVALUATION, source.input if source is not None else None
    in_folder = truth is not None and os.path.isdir(local(truth))  # pairs of a table have no ground truth
    scored = [scene for scene in scenes if in_folder and scene.has_truth]
    others = [scene for scene in scenes if not (in_folder and scene.has_truth)]
    shown = _without_truth(job, others, rows, options.output) if html and others else None
    if scored and truth is not None:
        judged = [scene for scene in job.truth_scenes(scenes) if scene.problem or scene.has_truth]
        by_name, views = {str(row["scene"]): row for row in rows}, viewers(reporter, output, html, run=shown)
        choices = Choices(rows=by_name, conditions=conditions, viewers=views, reporter=reporter)
        return evaluate_runs([options.output], judged, local(truth), output, choices)
    shows = ": the page shows the maps without scores" if html else ", nothing to compare with"
    reporter.info(f"no ground truth in {truth or 'the given files'}{shows}")
    flags = flag_rows(conditions, rows, reporter) if conditions else Flags()
    runs = tuple(run_names([options.output]))
    report = EvaluationReport(runs, (), {}, "" if truth is None else origin(truth), flags=flags)
    if shown is not None:
        page = Page(reporter.command_line, run=shown)
        with (
            can_be_missed(page.file, report.unwritten, reporter),
            staging_folder(output, "evaluate", RESULTS, reporter.info) as folder,
        ):
            page.begin(folder)
            page.write(report, "{}", {shown.name: read_text(shown.folder / RUN_FILE)})
    return report


def _without_truth(
    job: SceneJob[SceneT], scenes: Sequence[SceneT], rows: Sequence[Row], folder: Path
) -> RunWithoutTruth:
    """Return the page's views of scenes without ground truth; a sequence is shown frame by frame."""
    by_name, shown, row_of = {str(row["scene"]): row for row in rows}, list[Scene](), dict[str, Row]()
    for scene in scenes:
        row = by_name.get(scene.name, {})
        if isinstance(scene, SequenceScene):  # its row has means over the frames
            shown += scene.frames
            row_of |= {frame.name: {key: row.get(key, "") for key in ("status", "error")} for frame in scene.frames}
        else:
            shown.append(scene)
            row_of[scene.name] = row
    (run,) = run_names([folder])
    columns = job.shown.columns if job.shown.page_columns is None else job.shown.page_columns
    own = [(scene.name, by_name[scene.name]) for scene in scenes if scene.name in by_name]
    warnings = summarized((name, line) for name, row in own for line in row.get("warnings") or ())
    bounds = frozenset(name for name, row in own if job.is_lower_bound(row))
    judge = load(job.shown.protocol)()
    return RunWithoutTruth(run, folder, judge, job.shown.palette, shown, row_of, columns, warnings, bounds)


def viewers(
    reporter: Reporter, output: Path | None, html: bool, html_budget: str = "50MB", run: RunWithoutTruth | None = None
) -> list[Viewer]:
    """Return the views of an evaluation: document, contact sheet, and the page if ``html``.

    Raise ConfigError if the page has no folder, or ``html_budget`` is no size.
    """
    shown: list[Viewer] = [Document(), ContactSheet()]
    if not html:
        return shown
    if output is None:
        raise ConfigError("--html needs --output, the folder to write the page into")
    return [*shown, Page(reporter.command_line, parse_bytes(html_budget, "--html-budget"), run)]


def check_tables(options: TableOptions) -> None:
    """Raise ConfigError for unknown formats or tables."""
    if options.format is not None and options.format not in FORMATS:
        raise ConfigError(f"--format: must be one of {', '.join(FORMATS)} (got {options.format!r})")
    if wrong := [name for name in _listed(options.tables) if name.partition("-")[0] not in (*NAMES, "all")]:
        raise ConfigError(f"--tables: expected all, {', '.join(NAMES)} (got {', '.join(wrong)})")


def print_tables(report: EvaluationReport, reporter: Reporter, options: TableOptions, quiet: bool) -> None:
    """Print the tables that the options select; by default, the headline."""
    names, columns, form = _listed(options.tables), _listed(options.columns), options.format
    if form is None and columns == [] and options.caption is None and names in ([], ["headline"]):
        text = "" if quiet else headline_text(report)
    else:
        names = names or ([] if form else ["overview", "headline"])
        text = chosen_text(report, names, columns, form, options.caption)
    if text:
        reporter.data(text)


def print_place(report: EvaluationReport, output: Path, html: bool, reporter: Reporter) -> None:
    """Print the file to open; ``html`` means that a page was requested."""
    if html and PAGE_FILE not in report.unwritten:
        what = "report, with all tables and pictures" if report.results else "page to open in a browser"
        reporter.info(f"{what}: {output / PAGE_FILE}")
    elif report.results:
        more = "" if html else "; --html makes a page of it"
        reporter.info(f"report, with all tables and pictures: {output / 'report.md'}{more}")


def _listed(text: str | None) -> list[str]:
    """Return the parts of ``a,b`` without spaces around them."""
    return [part for each in (text or "").split(",") if (part := each.strip())]
