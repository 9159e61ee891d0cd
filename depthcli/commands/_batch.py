"""A run from its scenes to its exit code: compute, evaluate where requested, print."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from pydantic import BaseModel

from depthcli.commands._options import NOWHERE, RunOptions, SceneOptions
from depthcli.commands._shared_options import TableOptions
from depthcli.core.config_file import dump_config, load_config
from depthcli.core.errors import InputError
from depthcli.core.memory import BASE_BYTES
from depthcli.core.method import used_files
from depthcli.core.root_config import RootConfig
from depthcli.core.text import one_line, show_bytes
from depthcli.core.yaml_source import to_yaml
from depthcli.io.formats.status import write_legend
from depthcli.problems.problem import SceneJob
from depthcli.run.flags import Flags, flag_rows
from depthcli.run.folder import EVALUATION, LEGEND_FILE, refusal
from depthcli.run.job import Execution, SceneT
from depthcli.run.json_csv import Row, to_json
from depthcli.run.presets import find_config, find_preset
from depthcli.run.records import read_record
from depthcli.run.report import report_document
from depthcli.run.runner import Plan, run_scenes
from depthcli.run.workers import BUG
from depthcli.show.table import aligned, run_table

if TYPE_CHECKING:
    from depthcli.evaluation.comparison import EvaluationReport

ModelT = TypeVar("ModelT", bound=RootConfig)

DONE, TO_DO, BROKEN = "done, kept", "to do", "cannot be used"


def config_of(
    model: type[ModelT], config: str, settings: Sequence[str | tuple[str, str]] | None, **options: object
) -> ModelT:
    """Return the config of a command with all overrides.

    Parameters
    ----------
    model : class of the command's configs
    config, settings : the CONFIG argument, and the values of ``--set``
    options : config key -> value of the option of that name; None: not given

    Raises
    ------
    ConfigError
        All that is wrong, or a file that a method uses is missing.
    """
    given: list[str | tuple[str, str]] = list(settings or [])
    for key, value in options.items():
        if value is not None:
            given.append((f"--{key.rpartition('.')[2].replace('_', '-')}", f"{key}={value}"))
    found = load_config(model, find_config(model.command, config), given, lambda name: find_preset(model.command, name))
    used_files(found)  # missing ones are an error before any scene is opened
    return found


def run_batch(
    batch: SceneJob[SceneT],
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
    if options.dry_run:
        plan = plan_of(batch, scenes, options.output, how)
        if options.json:
            reporter.data(to_json(plan))
            return 0
        reporter.info(_plan_text(plan, batch.config))
    if options.dry_run or options.list_scenes:
        names = [scene.name for scene in how.own(scenes)]
        lines = "".join(f"{one_line(name)}\n" for name in names)
        reporter.data(to_json({"command": batch.command, "scenes": names}) if options.json else lines)
        return 0
    rows, elsewhere = run_scenes(batch, scenes, options.output, how, reporter)
    for line in batch.notes(scenes, rows):
        reporter.info(f"warning: {line}")
    problems = batch.problems(rows)
    for line in problems:
        reporter.error(line)
    failed = [row for row in rows if row["status"] == "failed"]
    if batch.shown.palette is not None and len(failed) < len(rows):
        write_legend(options.output / LEGEND_FILE, batch.shown.palette, batch.shown.legend)
    evaluation = None
    if (options.evaluate or options.html) and not elsewhere:
        from depthcli.commands import _evaluation, _scores  # only a run that is evaluated needs the evaluation

        evaluation = _scores.evaluated(batch, scenes, rows, options, source)
    flags = flag_rows(options.conditions, rows, reporter) if evaluation is None else evaluation.flags
    _print_results(batch, rows, options, evaluation, flags)
    total = len(scenes) if how.shard is None else len(rows)
    reporter.info(f"{len(rows) - len(failed)} of {total} scenes done, in {options.output}")
    if evaluation is not None:
        _evaluation.print_place(evaluation, options.output / EVALUATION, options.html, reporter)
    elif options.evaluate or options.html:
        reporter.info("the process that ends last evaluates the run")
    if any(row["error"].startswith(BUG) for row in (failed[-1:] if options.fail_fast else failed)):
        return 1
    incomplete = failed or problems or (evaluation is not None and evaluation.incomplete)
    return flags.exit_code(bool(incomplete), options.fail_flagged, all_rows=options.shard is None and not elsewhere)


def _print_results(
    batch: SceneJob[Any], rows: Sequence[Row], options: RunOptions, evaluation: EvaluationReport | None, flags: Flags
) -> None:
    """Print the report as JSON, or the tables of the evaluation or of the run, and the flagged rows."""
    reporter = options.reporter
    evaluation = evaluation if evaluation is not None and evaluation.results else None
    if options.json:
        document = report_document(batch.command, rows) | flags.to_dict()
        reporter.data(to_json(document if evaluation is None else document | {"evaluation": evaluation.to_dict()}))
        return
    if evaluation is not None:
        from depthcli.commands._evaluation import print_tables

        print_tables(evaluation, reporter, TableOptions(), options.quiet)
    elif not options.quiet:
        reporter.data(run_table(rows, batch.shown.columns))
    if options.conditions and not options.quiet:
        reporter.data(flags.text())


def plan_of(batch: SceneJob[SceneT], scenes: Sequence[SceneT], output: Path, how: Execution) -> Row:
    """Return what a run would do: its config, why it would reject the folder, and a row for every scene.

    A row has ``scene``, ``status`` (``DONE``, ``TO_DO`` or ``BROKEN``), ``memory`` (bytes or None) and ``problem``.
    """
    planned, rows = Plan(batch, scenes, output, how), []
    for scene in how.own(scenes):
        row: Row = {"scene": scene.name, "status": BROKEN, "memory": None, "problem": scene.problem}
        if not scene.problem:
            task, known = planned.task(scene, 0), read_record(output / scene.name)
            row["status"] = DONE if known is not None and task.is_done(known) else TO_DO
            try:
                need = batch.memory(scene)
                row["memory"] = None if need is None else BASE_BYTES + need
            except InputError as error:
                row |= {"status": BROKEN, "problem": str(error)}
        rows.append(row)
    refused = ""
    if refusal(output, planned.work.text):
        refused = f"{output}: has a run of another config; needs --overwrite"
    config, place = batch.config, None if output == NOWHERE else str(output)
    values = config.model_dump(mode="json", by_alias=True) if isinstance(config, BaseModel) else dict(config)
    return {"command": batch.command, "config": values, "output": place, "refused": refused, "scenes": rows}


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
