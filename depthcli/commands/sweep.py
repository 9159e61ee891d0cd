"""Run a config with many settings; compare the results.

Every combination has a run folder of its own, and so have the config's own values where no combination has them.
Finished runs are kept when a sweep is repeated or extended.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from depthcli.commands._old_batch import ConfigCommand
from depthcli.commands._old_options import CONFIG, LAYOUT, OUTPUT, RUN, SCENES, run_options
from depthcli.core.errors import ConfigError
from depthcli.core.option import Option
from depthcli.run.batch import SOME_FAILED
from depthcli.run.command import Command, Values
from depthcli.run.console import Reporter, aligned
from depthcli.run.json_csv import Row, to_csv, to_json

if TYPE_CHECKING:
    from pydantic import BaseModel

    from depthcli.evaluation.comparison import EvaluationReport, Section
    from depthcli.io.scenes import Scene
    from depthcli.run.combinations import Axis, Combination, Effect

_RUNS = "runs"  # the folder with one run folder per combination
_OWN = "own-values"  # name of the run of the config as it is
_TABLES = ("sweep.json", "sweep.csv")
_MAX_SHOWN = 20  # runs in the printed table; files hold all


class SweepCommand(Command):
    """``depthcli sweep CONFIG --over KEY=VALUES ... --input DIR --output DIR``."""

    arguments = (CONFIG,)

    options = (
        Option("over", str, "KEY=2,4,8 or KEY=FIRST:LAST:STEP; repeatable.", "KEY=VALUES",
               repeatable=True, required=True),
        Option("command", str, "The command of CONFIG.", "COMMAND", default="stereo"),
        Option("input", Path, "Folder of scenes.", "DIR", short="-i", required=True, group="Input"),
        OUTPUT,
        Option("random", int, "Draw N combinations at random, not all.", "N", min_value=1),
        Option("seed", int, "Seed of --random.", "N", default=0, min_value=0),
        LAYOUT,
        SCENES,
        Option("set", str, "Override one key in all runs; repeatable.", "KEY=VALUE", repeatable=True),
        *RUN,
        Option("dry_run", bool, "List the runs, with how much of each is done.", default=False, group="Run"),
        Option("html", bool, "Also write report.html: maps and errors in a browser.", default=False, group="Report"),
        Option("html_budget", str, "Size of its pictures beyond which they are scaled down.", "SIZE", default="50MB",
               group="Report"),
    )  # fmt: skip

    page = "how_to/sweep"
    examples = ("depthcli sweep accurate --over optimization.p2=2,4,8 -i scenes -o sweep",)

    def run(self, values: Values, reporter: Reporter) -> int:
        """Run every combination, evaluate all runs, and return the exit code.

        Raises
        ------
        ConfigError
            A config, key or value is wrong; nothing was computed.
        """
        from depthcli.run.combinations import combinations, folder_names, parse_axis, value_text

        command, own_run = _command(values["command"]), ""
        axes = [parse_axis(text) for text in values["over"]]
        chosen = combinations(axes, values["random"], values["seed"])
        names = folder_names(axes, chosen)
        given = {option.name: option.default for option in (*command.arguments, *command.options)}
        given |= {name: value for name, value in values.items() if name in given}
        given |= {"json": False, "quiet": True, "evaluate": False, "html": False, "name": None}
        each = {}
        for name, combination in zip(names, chosen, strict=True):
            settings = [(f"--over {axis.key}", f"{axis.key}={v}") for axis, v in zip(axes, combination, strict=True)]
            folder = values["output"] / _RUNS / name
            each[name] = {**given, "set": [*(values["set"] or []), *settings], "output": folder}
        configs = {name: command.config(own) for name, own in each.items()}
        tried = dict(zip(names, chosen, strict=True))
        with contextlib.suppress(ConfigError):  # a config that needs the values of --over has none of its own
            unchanged = {**given, "set": values["set"], "output": values["output"] / _RUNS / _OWN}
            config = command.config(unchanged)
            if config not in configs.values():
                each, configs = {_OWN: unchanged, **each}, {_OWN: config, **configs}
                tried[_OWN] = tuple(
                    value_text(config.model_dump(mode="json", by_alias=True), axis.key) for axis in axes
                )
            own_run = next(name for name, other in configs.items() if other == config)
        if values["dry_run"]:
            return _print_plan(command, each, configs, values, reporter)
        _check_output(values["output"])
        failed = False
        for number, (name, own) in enumerate(each.items(), 1):
            reporter.info(f"run {number} of {len(each)}: {name}")
            failed |= command.run(own, reporter) != 0
        report = _evaluate(self, values, list(each), reporter)
        if report is not None:
            _print_result(axes, tried, own_run, report, values, reporter)
            failed |= bool(report.failed)
            if values["html"]:
                reporter.info(f"page to open in a browser: {values['output'] / 'evaluation' / 'report.html'}")
        return SOME_FAILED if failed else 0


def _check_output(output: Path) -> None:
    """Raise ConfigError where tables would replace files that no sweep wrote: it has a folder of runs beside them."""
    for name in _TABLES:
        if (output / name).exists() and not (output / _RUNS).is_dir():
            raise ConfigError(f"{output / name}: is no sweep's; move it away, or choose another --output")


def _command(name: str) -> ConfigCommand[BaseModel, Scene]:
    from depthcli.commands import CONFIG_COMMANDS, find

    found = find(name) if name in CONFIG_COMMANDS else None
    if not isinstance(found, ConfigCommand):
        raise ConfigError(f"--command: must be one of {', '.join(CONFIG_COMMANDS)} (got {name!r})")
    return found


def _print_plan(
    command: ConfigCommand[BaseModel, Scene],
    each: Mapping[str, Values],
    configs: Mapping[str, BaseModel],
    values: Values,
    reporter: Reporter,
) -> int:
    from depthcli.run.plan import DONE, plan_document

    rows = []
    for name, own in each.items():
        scenes = command.find(own, reporter)
        document = plan_document(command, configs[name], scenes, own["output"], command.memory_of, run_options(own))
        done = sum(row["status"] == DONE for row in document["scenes"])
        rows.append({"run": name, "scenes": len(document["scenes"]), "done": done, "refused": document["refused"]})
    if values["json"]:
        reporter.data(to_json({"command": command.name, "runs": rows}))
    else:
        lines = [
            ("run", "", "scenes", "done"),
            *((r["run"], r["refused"], str(r["scenes"]), str(r["done"])) for r in rows),
        ]
        reporter.data(aligned(lines) + "\n\nnothing was computed\n")
    return 0


def _evaluate(sweep: SweepCommand, values: Values, names: Sequence[str], reporter: Reporter) -> EvaluationReport | None:
    from depthcli.commands._evaluation import viewers
    from depthcli.evaluation.evaluate import evaluate_runs
    from depthcli.io.walk import discover_scenes

    scenes = discover_scenes(values["input"], None, values["layout"], values["scenes"] or ["*"])
    if not any(scene.has_truth for scene in scenes):
        reporter.info(f"{values['input']}: no ground truth there, the runs are not compared")
        return None
    target = values["output"] / "evaluation"
    runs = [values["output"] / _RUNS / name for name in names]
    return evaluate_runs(
        runs, values["input"], target, values["scenes"] or ["*"], values["layout"], reporter=reporter,
        viewers=viewers(reporter, target, values["html"], values["html_budget"]),
    )  # fmt: skip


def _print_result(
    axes: Sequence[Axis],
    tried: Mapping[str, Combination],
    own_run: str,
    report: EvaluationReport,
    values: Values,
    reporter: Reporter,
) -> None:
    """Print the runs by their figure and the effect of every key; write both to ``sweep.csv`` and ``sweep.json``.

    Parameters
    ----------
    tried : run -> its value of every key
    own_run : the run that has the config's own values, or empty
    """
    from depthcli.evaluation.statistics import mean_of_known
    from depthcli.io.formats.files import remove_temporaries, write_text
    from depthcli.run.combinations import document_of, effects

    rows: list[Row] = []
    documents, texts = [], []
    for section in report.sections:
        headline, where = section.protocol.headline, {"data_set": section.data_set, "protocol": section.protocol.name}
        figures = {run: section.overall(run).value for run in report.runs}
        order = sorted(report.runs, key=lambda run: (math.isnan(figures[run]), headline.sign * figures[run]))
        combined = {tried[run]: figures[run] for run in report.runs if run != _OWN}
        found = effects(axes, combined, headline.larger_is_better)
        for run in order:
            settings = {axis.key: value for axis, value in zip(axes, tried[run], strict=True)}
            seconds = mean_of_known(r.seconds for r in section.results_of(run))
            rows.append({**where, "run": run, **settings, headline.heading: figures[run], "seconds": seconds,
                         "missing": section.n_missing(run), "own_values": run == own_run})  # fmt: skip
        documents.append({**where, "headline": headline.heading, "unit": headline.unit,
                          "larger_is_better": headline.larger_is_better, "best": order[0],
                          "runs": rows[-len(order):],
                          "sensitivity": [document_of(effect) for effect in found]})  # fmt: skip
        texts.append(_text(section, order, own_run, figures, found))
    document = {"over": {axis.key: axis.values for axis in axes}, "results": documents}
    for name, text in zip(_TABLES, (to_json(document), to_csv(rows)), strict=True):
        if values["shard"] is None:  # shards write the same tables, perhaps at this moment
            remove_temporaries(values["output"], name)
        write_text(values["output"] / name, text)
    if values["json"]:
        reporter.data(to_json(document))
    elif not values["quiet"]:
        reporter.data("\n".join(texts))
    reporter.info(f"runs, evaluation, sweep.csv and sweep.json in {values['output']}")


def _text(
    section: Section, order: Sequence[str], own_run: str, figures: Mapping[str, float], found: Sequence[Effect]
) -> str:
    from depthcli.evaluation.render import Number, Table
    from depthcli.evaluation.statistics import mean_of_known

    headline = section.protocol.headline
    shown = [run for place, run in enumerate(order) if place < _MAX_SHOWN or run == own_run]
    rows = [
        (f"{run} *" if run == own_run else run, Number(figures[run]),
         Number(mean_of_known(r.seconds for r in section.results_of(run))))
        for run in shown
    ]  # fmt: skip
    what = headline.heading_with_unit
    more = f"; the first {_MAX_SHOWN} of {len(order)}" if len(order) > _MAX_SHOWN else ""
    runs = Table(
        f"{section.data_set} - {section.protocol.presentation.title}, mean of {len(section.scenes)} scenes: the best "
        f"first{more}",
        ("run", what, "seconds"),
        tuple(rows),
        "*: the config's own values" if own_run else "",
    )
    lines = [
        (effect.key if first else "", value, str(effect.runs[value]), Number(mean_), Number(effect.best[value]),
         Number(effect.spread) if first else "", Number(100 * effect.share, 0) if first else "")
        for effect in found
        for first, (value, mean_) in zip((True, *[False] * len(effect.means)), effect.means.items(), strict=False)
    ]  # fmt: skip
    header = ("key", "value", "runs", f"mean {what}", "best", "spread of means", "% of variance")
    note = "spread: largest difference of the means; % of variance: what the key explains alone"
    return runs.text() + "\n" + Table("Sensitivity, the strongest first", header, tuple(lines), note).text()


COMMAND = SweepCommand()
