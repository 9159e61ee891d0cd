"""Carry out a run from the command line to its exit code: config, scenes, computation, evaluation, tables."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel

from depthcli import problems
from depthcli.commands._options import (
    NOWHERE,
    CodingOptions,
    PairOptions,
    RunOptions,
    SceneOptions,
    ScoredRunOptions,
    TableOptions,
)
from depthcli.core.config_file import config_with_options, dump_config
from depthcli.core.errors import SOME_FAILED, InputError
from depthcli.core.memory import BASE_BYTES
from depthcli.core.text import one_line, show_bytes
from depthcli.core.yaml_source import to_yaml
from depthcli.io.formats.disparity import write_codes
from depthcli.io.scenes import find
from depthcli.io.scenes.places import local
from depthcli.io.scenes.rows import Layouts
from depthcli.problems.problem import SceneJob, check_keep
from depthcli.run.flags import Flags, flag_rows
from depthcli.run.folder import EVALUATION, LEGEND_FILE, check_folder, refusal
from depthcli.run.job import SceneT
from depthcli.run.records import read_record, report_document
from depthcli.run.runner import Plan, run_scenes
from depthcli.run.scene import BUG
from depthcli.show.table import Row, aligned, run_table, to_json

if TYPE_CHECKING:
    from depthcli.evaluation.comparison import EvaluationReport
    from depthcli.problems.given_maps import GivenMaps

DONE, TO_DO, BROKEN = "done, kept", "to do", "cannot be used"
"""The status of a scene in a plan."""


def run_problem(
    command: str,
    config: str,
    source: SceneOptions,
    run: ScoredRunOptions,
    settings: Sequence[str] | None,
    adapted: Callable[[list[Any]], list[Any]] = list,
    **options: object,
) -> int:
    """Solve a command's problem for all scenes that the options name, and return the exit code.

    ``options`` are config key -> value of the option with that name, or None if it is not given. ``adapted`` applies
    further options to the scenes.
    """
    job, scenes = job_and_scenes(command, config, source, run, settings, adapted, **options)
    return run_job(job, scenes, run, source)


def job_and_scenes(
    command: str,
    config: str,
    source: SceneOptions,
    run: RunOptions,
    settings: Sequence[str | tuple[str, str]] | None,
    adapted: Callable[[list[Any]], list[Any]] = list,
    **options: object,
) -> tuple[SceneJob[Any], Sequence[Any]]:
    """Return a command's problem with its config, and its scenes; parameters are as for ``run_problem``."""
    problem = problems.load(command)
    job = problem.ready(config_with_options(problem.model, config, settings, options))
    scenes = adapted(find_scenes(problem.layouts, source, run))
    return job, job.units(scenes, run.reporter)


def find_scenes(layouts: Layouts[SceneT], source: SceneOptions, run: RunOptions) -> list[SceneT]:
    """Return the scenes that ``--input`` or the options for a single scene name.

    ``layouts`` are the layouts of the command's kind of scene: ``PAIRS``, ``FRAMES`` or ``VOLUMES``. Raise the errors
    of :func:`depthcli.io.scenes.find.find_scenes`.
    """
    patterns, with_truth = source.scenes or ["*"], isinstance(run, ScoredRunOptions) and run.evaluate
    return find.find_scenes(layouts, vars(source), source.single_files, patterns, with_truth, run.reporter.info)


def run_maps(
    job: GivenMaps[Any],
    pairs: PairOptions,
    coding: CodingOptions,
    run: ScoredRunOptions,
    maps: Sequence[str],
    witnesses: Sequence[str] = (),
    right_maps: str | None = None,
) -> int:
    """Solve the problem for the pairs that the options name, with their maps, and return the exit code."""
    from depthcli.problems.given_runs import with_maps

    scenes, place = find_scenes(job.layouts, pairs, run), pairs.input and local(pairs.input)
    coded = coding.pattern, coding.scale, coding.invalid
    found = with_maps(scenes, place, coded, run.reporter, maps, witnesses, right_maps)
    return run_job(job, found, run, pairs)


def run_job(
    job: SceneJob[SceneT],
    scenes: Sequence[SceneT],
    options: RunOptions,
    source: SceneOptions | None = None,
    html: bool = False,
) -> int:
    """Compute scenes into the run folder, evaluate if requested, print table or JSON, and return the exit code.

    Parameters
    ----------
    source : the options that name the scenes; their folder may have ground truth
    html : ``--html`` of options that are no ScoredRunOptions
    """
    evaluate = False
    if isinstance(options, ScoredRunOptions):
        evaluate, html = options.evaluate, options.html
    reporter, how = options.reporter, options.execution
    check_keep(job, how.keep)
    if options.dry_run or options.list_scenes:
        _print_plan(job, scenes, options)
        return 0
    rows, elsewhere = run_scenes(job, scenes, options.output, how, reporter)
    failed = [row for row in rows if row["status"] == "failed"]
    for line in job.notes(scenes, rows):
        reporter.info(f"warning: {line}")
    missing = job.problems(rows)
    for line in missing:
        reporter.error(line)
    if job.shown.palette is not None and len(failed) < len(rows):
        write_codes(options.output / LEGEND_FILE, job.shown.palette, job.shown.legend)
    total = len(scenes) if how.shard is None else len(rows)
    done = f"{len(rows) - len(failed)} of {total} scenes done, in {options.output}"
    if (evaluate or html) and not elsewhere:
        evaluation = _evaluate(job, scenes, rows, done, options, source, html)
        flags, incomplete = evaluation.flags, evaluation.incomplete
    else:
        flags, incomplete = flag_rows(options.conditions, rows, reporter) if options.conditions else Flags(), False
        _print_results(job, rows, done, options, None, flags)
        if evaluate or html:
            reporter.info("the process that ends last evaluates the run")
    all_rows = how.shard is None and not elsewhere
    return _exit_code(failed, incomplete or bool(missing), flags, all_rows, options)


def _evaluate(
    job: SceneJob[SceneT],
    scenes: Sequence[SceneT],
    rows: Sequence[Row],
    done: str,
    options: RunOptions,
    source: SceneOptions | None,
    html: bool,
) -> EvaluationReport:
    """Compare a run with the ground truth, print its tables, and where the report is; ``html`` also writes the page."""
    from depthcli.commands._scores import evaluated, print_place

    evaluation = evaluated(job, scenes, rows, options, source, html)
    _print_results(job, rows, done, options, evaluation, evaluation.flags)
    print_place(evaluation, options.output / EVALUATION, html, options.reporter)
    return evaluation


def _exit_code(failed: Sequence[Row], incomplete: bool, flags: Flags, all_rows: bool, options: RunOptions) -> int:
    """Return the exit code of a run; ``all_rows`` is false while other processes compute some."""
    if failed:
        causes = failed[-1:] if options.fail_fast else failed
        return 1 if any(row["error"].startswith(BUG) for row in causes) else SOME_FAILED
    if incomplete:
        return SOME_FAILED
    return flags.exit_code(all_rows) if options.fail_flagged else 0


def _print_plan(job: SceneJob[SceneT], scenes: Sequence[SceneT], options: RunOptions) -> None:
    """Print the plan of a run for ``--dry-run``, and the names of its scenes.

    Raise the errors with which the run itself would refuse its folder.
    """
    reporter, how = options.reporter, options.execution
    if options.dry_run:
        planned = Plan(job, scenes, options.output, how)
        plan = plan_of(planned)
        if options.json:
            reporter.data(to_json(plan))
        else:
            reporter.info(_plan_text(plan, job.config))
        if options.output != NOWHERE:
            planned.check_names()
            check_folder(options.output, planned.text, how.overwrite)
        if options.json:
            return
    names = [scene.name for scene in how.own(scenes)]
    lines = "".join(f"{one_line(name)}\n" for name in names)
    reporter.data(to_json({"command": job.command, "scenes": names}) if options.json else lines)


def plan_of(planned: Plan) -> Row:
    """Return the plan of a run: its config, the reason if it would reject the folder, and a row for every scene.

    A row has ``scene``, ``status`` (``DONE``, ``TO_DO`` or ``BROKEN``), ``memory`` (bytes or None) and ``problem``.
    """
    job, output, rows = planned.work.job, planned.output, []
    for scene in planned.scenes:
        row: Row = {"scene": scene.name, "status": BROKEN, "memory": None, "problem": scene.problem}
        if not scene.problem:
            task = planned.task(scene, 0)
            row["status"] = DONE if task.is_done(read_record(task.target)) else TO_DO
            try:
                need = job.memory(scene)
                row["memory"] = None if need is None else BASE_BYTES + need
            except InputError as error:
                row |= {"status": BROKEN, "problem": str(error)}
        rows.append(row)
    refused = ""
    if refusal(output, planned.text):
        refused = f"{output}: has a run of another config; needs --overwrite"
    config, place = job.config, None if output == NOWHERE else str(output)
    values = config.model_dump(mode="json", by_alias=True) if isinstance(config, BaseModel) else dict(config)
    return {"command": job.command, "config": values, "output": place, "refused": refused, "scenes": rows}


def _plan_text(plan: Row, config: BaseModel | Mapping[str, object]) -> str:
    """Return a plan as text for ``--dry-run``: config, table of scenes, counts."""
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


def _print_results(
    job: SceneJob[Any],
    rows: Sequence[Row],
    done: str,
    options: RunOptions,
    evaluation: EvaluationReport | None,
    flags: Flags,
) -> None:
    """Print the report as JSON, or tables of the evaluation or run and the flagged rows; then the line ``done``."""
    reporter = options.reporter
    scored = evaluation if evaluation is not None and evaluation.results else None
    if options.json:
        document = report_document(job.command, rows) | (flags.to_dict() if options.conditions else {})
        reporter.data(to_json(document if scored is None else document | {"evaluation": scored.to_dict()}))
    else:
        if scored is not None:
            from depthcli.commands._scores import print_tables

            print_tables(scored, reporter, TableOptions(), options.quiet)
        elif not options.quiet:
            reporter.data(run_table(rows, job.shown.columns))
        if options.conditions and not options.quiet:
            reporter.data(flags.text())
    reporter.info(done)
