"""A run from the command line to its exit code: config, scenes, computing, evaluation, tables."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel

from depthcli import problems
from depthcli.commands._options import NOWHERE, CodingOptions, PairOptions, RangeOptions, RunOptions, SceneOptions
from depthcli.commands._shared_options import TableOptions, parse_bytes
from depthcli.core.config_file import dump_config
from depthcli.core.errors import ConfigError, InputError
from depthcli.core.memory import BASE_BYTES
from depthcli.core.text import one_line, show_bytes, summarized
from depthcli.core.yaml_source import to_yaml
from depthcli.io.formats.status import write_codes
from depthcli.io.scenes import Scene, SequenceScene, find
from depthcli.io.scenes.places import local, origin
from depthcli.io.scenes.rows import Layouts
from depthcli.problems.given_maps import GivenMaps, with_maps
from depthcli.problems.inputs import config_with_options
from depthcli.problems.problem import SceneJob, check_keep
from depthcli.problems.rectified import reading_fields
from depthcli.problems.stereo import PairConfig, with_reading
from depthcli.run.console import Reporter
from depthcli.run.flags import Flags, flag_rows
from depthcli.run.folder import EVALUATION, LEGEND_FILE, check_folder, refusal, saved_config, staging_folder
from depthcli.run.job import Execution, SceneT
from depthcli.run.json_csv import Row, to_json
from depthcli.run.records import read_record, report_document
from depthcli.run.runner import Plan, run_scenes
from depthcli.run.workers import BUG
from depthcli.show.table import aligned, run_table

if TYPE_CHECKING:
    from depthcli.evaluation.comparison import EvaluationReport
    from depthcli.evaluation.evaluate import Viewer
    from depthcli.report.without_truth import RunWithoutTruth

DONE, TO_DO, BROKEN = "done, kept", "to do", "cannot be used"


def run_problem(
    command: str,
    config: str,
    source: SceneOptions,
    run: RunOptions,
    settings: Sequence[str] | None,
    adapted: Callable[[list[Any]], list[Any]] = list,
    **options: object,
) -> int:
    """Solve the problem of a command for all scenes that the options name, and return the exit code.

    ``options`` are config key -> value of the option of that name; None: not given. ``adapted`` returns the scenes with
    what other options say of them.
    """
    return run_job(*prepared(command, config, source, run, settings, adapted, **options), run, source)


def prepared(
    command: str,
    config: str,
    source: SceneOptions,
    run: RunOptions,
    settings: Sequence[str | tuple[str, str]] | None,
    adapted: Callable[[list[Any]], list[Any]] = list,
    **options: object,
) -> tuple[SceneJob[Any], Sequence[Any]]:
    """Return the problem of a command with its config, and the scenes that it is solved for, as for ``run_problem``."""
    problem = problems.load(command)
    if isinstance(source, RangeOptions):
        options |= {key: getattr(source, key) for key in ("max_disparity", "min_disparity")}
        files = [str(path) for path in source.calibration or ()]
        options["calibration"] = files[0] if len(files) == 1 else json.dumps(files) if files else None
    checked = config_with_options(problem.model, config, settings, options)
    if isinstance(checked, PairConfig) and isinstance(source, RangeOptions):
        fields = reading_fields(source.unit, source.fisheye, source.cameras, source.alpha)
        checked = with_reading(checked, fields)
    job = problem.ready(checked)
    return job, job.units(adapted(find_scenes(problem.rows, source, run)), run.reporter)


def find_scenes(layouts: Layouts[SceneT], source: SceneOptions, run: RunOptions) -> list[SceneT]:
    """Return the scenes that ``--input``, or the options for the files of a single scene, name.

    ``layouts`` belong to the command's kind of scene: ``PAIRS``, ``FRAMES`` or ``VOLUMES``. Errors are those of
    :func:`depthcli.io.scenes.find.find_scenes`.
    """
    single = source.single_files
    return find.find_scenes(layouts, vars(source), single, source.patterns, bool(run.evaluate), run.reporter.info)


def run_maps(
    job: GivenMaps[Any],
    pairs: PairOptions,
    coding: CodingOptions,
    run: RunOptions,
    maps: Sequence[str],
    witnesses: Sequence[str] = (),
    right_maps: str | None = None,
) -> int:
    """Solve the problem for all pairs that the options name, with their maps, and return the exit code."""
    scenes, place = find_scenes(job.rows, pairs, run), pairs.input and local(pairs.input)
    coded = coding.pattern, coding.scale, coding.invalid
    return run_job(job, with_maps(scenes, place, coded, run.reporter, maps, witnesses, right_maps), run, pairs)


def run_job(
    job: SceneJob[SceneT],
    scenes: Sequence[SceneT],
    options: RunOptions,
    source: SceneOptions | None = None,
) -> int:
    """Compute scenes into the run folder, evaluate where requested, print table or JSON, and return the exit code.

    Parameters
    ----------
    source : the options that the scenes were found by, whose folder may have ground truth
    """
    reporter, how = options.reporter, options.execution
    check_keep(job, how.keep)
    if options.dry_run:
        plan = plan_of(job, scenes, options.output, how)
        if options.json:
            reporter.data(to_json(plan))
        else:
            reporter.info(_plan_text(plan, job.config))
        if options.output != NOWHERE:
            planned = Plan(job, scenes, options.output, how)
            planned.check_names(how.own(scenes))
            check_folder(options.output, planned.work.text, how.overwrite)
        if options.json:
            return 0
    if options.dry_run or options.list_scenes:
        names = [scene.name for scene in how.own(scenes)]
        lines = "".join(f"{one_line(name)}\n" for name in names)
        reporter.data(to_json({"command": job.command, "scenes": names}) if options.json else lines)
        return 0
    rows, elsewhere = run_scenes(job, scenes, options.output, how, reporter)
    for line in job.notes(scenes, rows):
        reporter.info(f"warning: {line}")
    problems = job.problems(rows)
    for line in problems:
        reporter.error(line)
    failed = [row for row in rows if row["status"] == "failed"]
    if job.shown.palette is not None and len(failed) < len(rows):
        write_codes(options.output / LEGEND_FILE, job.shown.palette, job.shown.legend)
    evaluation = None
    if (options.evaluate or options.html) and not elsewhere:
        evaluation = evaluated(job, scenes, rows, options, source)
    flags = flag_rows(options.conditions, rows, reporter) if evaluation is None else evaluation.flags
    _print_results(job, rows, options, evaluation, flags)
    total = len(scenes) if how.shard is None else len(rows)
    reporter.info(f"{len(rows) - len(failed)} of {total} scenes done, in {options.output}")
    if evaluation is not None:
        print_place(evaluation, options.output / EVALUATION, options.html, reporter)
    elif options.evaluate or options.html:
        reporter.info("the process that ends last evaluates the run")
    if any(row["error"].startswith(BUG) for row in (failed[-1:] if options.fail_fast else failed)):
        return 1
    incomplete = failed or problems or (evaluation is not None and evaluation.incomplete)
    return flags.exit_code(bool(incomplete), options.fail_flagged, all_rows=options.shard is None and not elsewhere)


def _print_results(
    job: SceneJob[Any], rows: Sequence[Row], options: RunOptions, evaluation: EvaluationReport | None, flags: Flags
) -> None:
    """Print the report as JSON, or the tables of the evaluation or of the run, and the flagged rows."""
    reporter = options.reporter
    evaluation = evaluation if evaluation is not None and evaluation.results else None
    if options.json:
        document = report_document(job.command, rows) | flags.to_dict()
        reporter.data(to_json(document if evaluation is None else document | {"evaluation": evaluation.to_dict()}))
        return
    if evaluation is not None:
        print_tables(evaluation, reporter, TableOptions(), options.quiet)
    elif not options.quiet:
        reporter.data(run_table(rows, job.shown.columns))
    if options.conditions and not options.quiet:
        reporter.data(flags.text())


def plan_of(job: SceneJob[SceneT], scenes: Sequence[SceneT], output: Path, how: Execution) -> Row:
    """Return what a run would do: its config, why it would reject the folder, and a row for every scene.

    A row has ``scene``, ``status`` (``DONE``, ``TO_DO`` or ``BROKEN``), ``memory`` (bytes or None) and ``problem``.
    """
    planned, rows = Plan(job, scenes, output, how), []
    for scene in how.own(scenes):
        row: Row = {"scene": scene.name, "status": BROKEN, "memory": None, "problem": scene.problem}
        if not scene.problem:
            task, known = planned.task(scene, 0), read_record(output / scene.name)
            row["status"] = DONE if known is not None and task.is_done(known) else TO_DO
            try:
                need = job.memory(scene)
                row["memory"] = None if need is None else BASE_BYTES + need
            except InputError as error:
                row |= {"status": BROKEN, "problem": str(error)}
        rows.append(row)
    refused = ""
    if refusal(output, planned.work.text):
        refused = f"{output}: has a run of another config; needs --overwrite"
    config, place = job.config, None if output == NOWHERE else str(output)
    values = config.model_dump(mode="json", by_alias=True) if isinstance(config, BaseModel) else dict(config)
    return {"command": job.command, "config": values, "output": place, "refused": refused, "scenes": rows}


def _plan_text(plan: Row, config: BaseModel | Mapping[str, object]) -> str:
    """Return a plan as the text that ``--dry-run`` prints: config, table of scenes, counts."""
    rows = plan["scenes"]
    lines = [("scene", "status", "memory", "")]
    for row in rows:
        memory = show_bytes(row["memory"]) if row["memory"] is not None else "-"
        lines.append((row["scene"], row["status"], memory, row["problem"]))
    counts = {status: sum(row["status"] == status for row in rows) for status in (DONE, TO_DO, BROKEN)}
    summary = ", ".join(f"{count} {status}" for status, count in counts.items() if count)
    notes = [f"{len(rows)} scenes: {summary}", *filter(None, [plan["refused"]]), "nothing was computed"]
    text = dump_config(config) if isinstance(config, BaseModel) else to_yaml(dict(config))
    return "\n".join([text, aligned(lines), "", *notes])


def evaluated(
    job: SceneJob[SceneT],
    scenes: Sequence[SceneT],
    rows: Sequence[Row],
    options: RunOptions,
    source: SceneOptions | None,
) -> EvaluationReport:
    """Compare scenes with their truth, and write the page of these and of the others; no results without truth."""
    # Only a run that is evaluated needs the evaluation.
    from depthcli.evaluation.comparison import EvaluationReport
    from depthcli.evaluation.evaluate import RESULTS, Choices, can_be_missed, evaluate_runs
    from depthcli.evaluation.map_files import run_names
    from depthcli.report.page import Page

    reporter, conditions = options.reporter, options.conditions
    output, truth = options.output / EVALUATION, source.input if source is not None else None
    in_folder = truth is not None and os.path.isdir(local(truth))  # pairs of a table have no truth
    scored = [scene for scene in scenes if in_folder and scene.has_truth]
    others = [scene for scene in scenes if not (in_folder and scene.has_truth)]
    shown = _without_truth(job, others, rows, options.output) if options.html and others else None
    if scored and truth is not None:
        judged = [scene for scene in job.truth_scenes(scenes) if scene.problem or scene.has_truth]
        by_name, views = {str(row["scene"]): row for row in rows}, viewers(reporter, output, options.html, run=shown)
        choices = Choices(rows=by_name, conditions=conditions, viewers=views, reporter=reporter)
        return evaluate_runs([options.output], judged, local(truth), output, choices)
    shows = ": the page shows the maps without scores" if options.html else ", nothing to compare with"
    reporter.info(f"no ground truth in {truth or 'the given files'}{shows}")
    flags, runs = flag_rows(conditions, rows, reporter), tuple(run_names([options.output]))
    report = EvaluationReport(runs, (), {}, "" if truth is None else origin(truth), flags=flags)
    if shown is not None:
        page = Page(reporter.command_line, run=shown)
        with (
            can_be_missed(page.file, report.unwritten, reporter),
            staging_folder(output, "evaluate", RESULTS, reporter.info) as folder,
        ):
            page.begin(folder)
            page.write(None, "{}", {shown.name: saved_config(shown.folder)}, flags)
    return report


def _without_truth(
    job: SceneJob[SceneT], scenes: Sequence[SceneT], rows: Sequence[Row], folder: Path
) -> RunWithoutTruth:
    """Return the views of scenes without truth for the page; a sequence is shown frame by frame."""
    from depthcli.evaluation.map_files import run_names
    from depthcli.evaluation.protocols import load
    from depthcli.report.without_truth import RunWithoutTruth

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
    """Return what shows the maps of an evaluation: document, contact sheet, and the page that ``--html`` requests.

    ConfigError if the page has no folder, or ``html_budget`` is no size.
    """
    from depthcli.report.contact_sheet import ContactSheet
    from depthcli.report.document import Document
    from depthcli.report.page import Page

    shown: list[Viewer] = [Document(), ContactSheet()]
    if not html:
        return shown
    if output is None:
        raise ConfigError("--html needs --output, the folder to write the page into")
    return [*shown, Page(reporter.command_line, parse_bytes(html_budget, "--html-budget"), run)]


def check_tables(options: TableOptions) -> None:
    """Raise ConfigError where a format or the name of a table is none."""
    from depthcli.report.tables import check_names
    from depthcli.show.table import FORMATS

    if options.format is not None and options.format not in FORMATS:
        raise ConfigError(f"--format: must be one of {', '.join(FORMATS)} (got {options.format!r})")
    check_names(_listed(options.tables))


def print_tables(report: EvaluationReport, reporter: Reporter, options: TableOptions, quiet: bool) -> None:
    """Print the tables that the options choose, or else the headline."""
    from depthcli.report.tables import chosen_text, headline_text

    names, columns, form = _listed(options.tables), _listed(options.columns), options.format
    if form is None and columns == [] and options.caption is None and names in ([], ["headline"]):
        text = "" if quiet else headline_text(report)
    else:
        names = names or ([] if form else ["overview", "headline"])
        text = chosen_text(report, names, columns, form, options.caption)
    if text:
        reporter.data(text)


def print_place(report: EvaluationReport, output: Path, html: bool, reporter: Reporter) -> None:
    """Print which file to open; ``html``: a page was requested."""
    from depthcli.evaluation.evaluate import PAGE_FILE

    if html and PAGE_FILE not in report.unwritten:
        what = "report, with all tables and pictures" if report.results else "page to open in a browser"
        reporter.info(f"{what}: {output / PAGE_FILE}")
    elif report.results:
        more = "" if html else "; --html makes a page of it"
        reporter.info(f"report, with all tables and pictures: {output / 'report.md'}{more}")


def _listed(text: str | None) -> list[str]:
    """Return the parts of ``a,b`` without spaces around them."""
    return [part for each in (text or "").split(",") if (part := each.strip())]
