"""Run a config with many settings; compare the results.

Every combination has its own run folder. The config's own values are also run, unless a combination has them.
Finished runs are kept when a sweep is repeated or extended.

Examples:
  depthcli sweep accurate --over optimization.p2=2,4,8 -i scenes -o sweep
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from typer import Option

from depthcli.commands._options import (
    ConfigArgument,
    HtmlBudgetOption,
    HtmlOption,
    LayoutOption,
    RunOptions,
    SceneOptions,
    ScenesOption,
    SetOption,
)
from depthcli.core.errors import SOME_FAILED, ConfigError
from depthcli.problems import PROBLEMS
from depthcli.show.table import aligned, to_csv, to_json

if TYPE_CHECKING:
    from depthcli.evaluation.comparison import EvaluationReport
    from depthcli.evaluation.sweeps import Axes, Combination
    from depthcli.problems.problem import SceneJob

_RUNS = "runs"  # folder with one run folder per combination
_TABLES = ("sweep.json", "sweep.csv")


class _Trial(NamedTuple):
    """A combination with its run."""

    values: Combination
    options: RunOptions
    job: SceneJob[Any]
    scenes: Sequence[Any]


def sweep(
    config: ConfigArgument,
    over: Annotated[list[str], Option(metavar="KEY=VALUES", help="KEY=2,4,8 or KEY=FIRST:LAST:STEP; repeatable.")],
    input: Annotated[Path, Option("--input", "-i", metavar="DIR", help="Folder of scenes.")],
    run: RunOptions,
    command: Annotated[str, Option(metavar="COMMAND", help="The command of CONFIG.")] = "stereo",
    random: Annotated[int | None, Option(metavar="N", min=1, help="Draw N combinations at random, not all.")] = None,
    seed: Annotated[int, Option(metavar="N", min=0, help="Seed of --random.")] = 0,
    layout: LayoutOption = None,
    scenes: ScenesOption = None,
    set: SetOption = None,
    html: HtmlOption = False,
    html_budget: HtmlBudgetOption = "50MB",
) -> int:
    """Run every combination, evaluate all runs, and print the ranked runs and the effect of every key."""
    from depthcli.evaluation.sweeps import combinations, parse_axes

    source = SceneOptions(input=input, layout=layout, scenes=scenes)
    axes = _with_keys(command, config, parse_axes(over))
    chosen = combinations(axes, random, seed)
    trials, own_run = _trials_of(command, config, set or [], axes, chosen, source, run)
    if run.dry_run:
        _show_plan(command, trials, run)
        return 0
    failed, others = _compute(trials, source, run)
    if others:
        run.reporter.info("the process that ends last compares the runs")
        return SOME_FAILED if failed else 0
    report = _evaluated(trials, source, run, html, html_budget)
    if report is None:
        run.reporter.info(f"{input}: no ground truth there, the runs are not compared")
        return SOME_FAILED if failed else 0
    _compare(report, axes, trials, own_run, run, html)
    return SOME_FAILED if failed or report.incomplete else 0


def _with_keys(command: str, config: str, axes: Axes) -> dict[str, Sequence[str]]:
    """Return the axes with symbols replaced by the config's keys."""
    from depthcli.core.config_file import find_config, symbols_of

    if command not in PROBLEMS:
        raise ConfigError(f"--command: must be one of {', '.join(PROBLEMS)} (got {command!r})")
    symbols = symbols_of(find_config(command, config), command)
    if twice := [key for key in axes if symbols.get(key) in axes]:
        raise ConfigError(f"--over {twice[0]}: is {symbols[twice[0]]}, which is varied already")
    return {symbols.get(key, key): values for key, values in axes.items()}


def _trials_of(
    command: str,
    config: str,
    settings: Sequence[str],
    axes: Axes,
    chosen: Sequence[Combination],
    source: SceneOptions,
    options: RunOptions,
) -> tuple[dict[str, _Trial], str]:
    """Return name -> trial, and the name of the one with the config's own values, or an empty text."""
    from depthcli.commands._run import job_and_scenes
    from depthcli.evaluation.sweeps import OWN_VALUES, folder_names, value_text

    def run_of(name: str, values: Combination) -> _Trial:
        place = options.output / _RUNS / name
        quiet = replace(options, output=place, json=False, quiet=True, flag=None, fail_flagged=False)
        own = [(f"--over {key}", f"{key}={value}") for key, value in zip(axes, values, strict=False)]
        job, scenes = job_and_scenes(command, config, source, quiet, [*settings, *own])
        return _Trial(values, quiet, job, scenes)

    names = folder_names(axes, chosen)
    runs = {name: run_of(name, values) for name, values in zip(names, chosen, strict=True)}
    try:
        plain = run_of(OWN_VALUES, ())
    except ConfigError:  # the config is incomplete without the values of --over
        return runs, ""
    if alike := [name for name, run in runs.items() if run.job.config == plain.job.config]:
        return runs, alike[0]
    own_config = plain.job.config.model_dump(mode="json", by_alias=True)
    plain = plain._replace(values=tuple(value_text(own_config, key) for key in axes))
    return {OWN_VALUES: plain, **runs}, OWN_VALUES


def _show_plan(command: str, trials: Mapping[str, _Trial], options: RunOptions) -> None:
    """Print the planned runs."""
    from depthcli.commands._run import DONE, plan_of
    from depthcli.run.runner import Plan

    rows = []
    for name, run in trials.items():
        plan = plan_of(Plan(run.job, run.scenes, run.options.output, run.options.execution))
        done = sum(row["status"] == DONE for row in plan["scenes"])
        rows.append({"run": name, "scenes": len(plan["scenes"]), "done": done, "refused": plan["refused"]})
    lines = [("run", "", "scenes", "done")]
    lines += [(row["run"], row["refused"], str(row["scenes"]), str(row["done"])) for row in rows]
    text = f"{aligned(lines)}\n\nnothing was computed\n"
    options.reporter.data(to_json({"command": command, "runs": rows}) if options.json else text)


def _compute(trials: Mapping[str, _Trial], source: SceneOptions, options: RunOptions) -> tuple[bool, bool]:
    """Compute all runs; return whether one failed, and whether other processes still compute some."""
    from depthcli.commands._run import run_job
    from depthcli.run.folder import FolderLock

    for table in _TABLES:
        if (options.output / table).exists() and not (options.output / _RUNS).is_dir():
            raise ConfigError(f"{options.output / table}: is no sweep's; move it away, or choose another --output")
    failed = False
    with FolderLock(options.output, options.reporter.info) as lock:
        lock.share()
        for count, (name, one) in enumerate(trials.items(), 1):
            options.reporter.info(f"run {count} of {len(trials)}: {name}")
            failed |= run_job(one.job, one.scenes, one.options, source) != 0
        return failed, lock.locks and not lock.last()


def _evaluated(
    trials: Mapping[str, _Trial], source: SceneOptions, options: RunOptions, html: bool, html_budget: str
) -> EvaluationReport | None:
    """Return the evaluation of all runs side by side, or None without ground truth."""
    from depthcli.commands._scores import viewers
    from depthcli.evaluation.evaluate import Choices, evaluate_runs
    from depthcli.io.scenes.find import ALL_KINDS, discover_scenes
    from depthcli.io.scenes.places import local
    from depthcli.run.folder import EVALUATION

    assert source.input is not None  # an argument of the command
    truth, folder, reporter = local(source.input), options.output / EVALUATION, options.reporter
    there = discover_scenes(truth, ALL_KINDS, source.layout, source.scenes or ["*"])
    if not any(scene.has_truth for scene in there):
        return None
    scored = [scene for scene in there if scene.problem or scene.has_truth]
    choices = Choices(viewers=viewers(reporter, folder, html, html_budget), reporter=reporter)
    return evaluate_runs([one.options.output for one in trials.values()], scored, truth, folder, choices)


def _compare(
    report: EvaluationReport,
    axes: Axes,
    trials: Mapping[str, _Trial],
    own_run: str,
    options: RunOptions,
    html: bool,
) -> None:
    """Write the ranked runs and the effect of every key, and print them."""
    from depthcli.commands._scores import print_place
    from depthcli.evaluation.sweeps import compared, text_of
    from depthcli.io.formats.files import write_text
    from depthcli.run.folder import EVALUATION

    output, reporter = options.output, options.reporter
    tried = {name: one.values for name, one in trials.items()}
    results = [compared(section, axes, tried, own_run) for section in report.sections]
    document = to_json({"over": axes, "results": results})
    write_text(output / _TABLES[0], document)
    write_text(output / _TABLES[1], to_csv([row for result in results for row in result["runs"]]))
    if options.json:
        reporter.data(document)
    elif not options.quiet:
        reporter.data("\n".join(map(text_of, report.sections, results)))
    reporter.info(f"runs, evaluation, sweep.csv and sweep.json in {output}")
    print_place(report, output / EVALUATION, html, reporter)
