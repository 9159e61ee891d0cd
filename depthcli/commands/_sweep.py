"""What ``sweep`` computes: a run of every combination of settings, and their comparison."""

from __future__ import annotations

import importlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from depthcli.commands import CONFIGS
from depthcli.commands._batch import DONE, plan_of, run_batch
from depthcli.commands._evaluation import print_place, viewers
from depthcli.commands._options import RunOptions, SceneOptions
from depthcli.commands._sweep_axes import Axes, Combination, effects, folder_names, value_text
from depthcli.core.errors import SOME_FAILED, ConfigError
from depthcli.evaluation.comparison import Section
from depthcli.evaluation.evaluate import Choices, evaluate_runs
from depthcli.evaluation.render import Number, Table
from depthcli.evaluation.statistics import mean_of_known
from depthcli.io.formats.files import write_text
from depthcli.io.scenes.find import ALL_KINDS, discover_scenes
from depthcli.io.scenes.places import local
from depthcli.problems.problem import SceneJob
from depthcli.run.console import aligned
from depthcli.run.folder import FolderLock
from depthcli.run.json_csv import Row, to_csv, to_json

_RUNS = "runs"  # the folder with one run folder per combination
_OWN = "own-values"  # name of the run of the config as it is
_TABLES = ("sweep.json", "sweep.csv")
_MAX_SHOWN = 20  # runs in the printed table; files list all


class _Run(NamedTuple):
    values: Combination
    options: RunOptions
    batch: SceneJob[Any]
    scenes: list[Any]


@dataclass(frozen=True)
class Sweep:
    """A command with a config, and the combinations of settings to run it with."""

    command: str
    config: str
    settings: Sequence[str]
    axes: Axes
    chosen: Sequence[Combination]
    source: SceneOptions
    options: RunOptions

    def run(self, html: bool, html_budget: str) -> int:
        """Run the combinations, each in a folder of its own, evaluate all runs, and return the exit code.

        Raises
        ------
        ConfigError
            A config, key or value is wrong; nothing was computed.
        """
        source, output, reporter = self.source, self.options.output, self.options.reporter
        runs, own_run = self._runs()
        if self.options.dry_run:
            self._show_plan(runs)
            return 0
        for table in _TABLES:
            if (output / table).exists() and not (output / _RUNS).is_dir():
                raise ConfigError(f"{output / table}: is no sweep's; move it away, or choose another --output")
        failed = False
        with FolderLock(output, reporter.info) as lock:
            lock.share()
            for count, (name, run) in enumerate(runs.items(), 1):
                reporter.info(f"run {count} of {len(runs)}: {name}")
                failed |= run_batch(run.batch, run.scenes, run.options, source) != 0
            others = lock.locks and not lock.last()
        if others:
            reporter.info("the process that ends last compares the runs")
            return SOME_FAILED if failed else 0
        assert source.input is not None
        truth = local(source.input)
        found = discover_scenes(truth, ALL_KINDS, source.layout, source.patterns)
        if not any(scene.has_truth for scene in found):
            reporter.info(f"{source.input}: no ground truth there, the runs are not compared")
            return SOME_FAILED if failed else 0
        folder, places = output / "evaluation", [run.options.output for run in runs.values()]
        scored = [scene for scene in found if scene.problem or scene.has_truth]
        choices = Choices(viewers=viewers(reporter, folder, html, html_budget), reporter=reporter)
        report = evaluate_runs(places, scored, truth, folder, choices)
        tried = {name: run.values for name, run in runs.items()}
        results = [_compared(section, self.axes, tried, own_run) for section in report.sections]
        document = to_json({"over": dict(self.axes), "results": results})
        write_text(output / _TABLES[0], document)
        write_text(output / _TABLES[1], to_csv([row for result in results for row in result["runs"]]))
        if self.options.json:
            reporter.data(document)
        elif not self.options.quiet:
            reporter.data("\n".join(map(_text, report.sections, results)))
        reporter.info(f"runs, evaluation, sweep.csv and sweep.json in {output}")
        print_place(report, folder, html, reporter)
        return SOME_FAILED if failed or report.incomplete else 0

    def _runs(self) -> tuple[dict[str, _Run], str]:
        """Return name -> run, and the name of the run that has the config's own values; empty where none has."""
        if self.command not in CONFIGS:
            raise ConfigError(f"--command: must be one of {', '.join(CONFIGS)} (got {self.command!r})")
        prepare = importlib.import_module(f"depthcli.commands._{self.command.replace('-', '_')}").prepare

        def prepared(name: str, values: Combination) -> _Run:
            place = self.options.output / _RUNS / name
            options = replace(self.options, output=place, json=False, quiet=True, flag=None, fail_flagged=False)
            own = [(f"--over {key}", f"{key}={value}") for key, value in zip(self.axes, values, strict=False)]
            return _Run(values, options, *prepare(self.config, self.source, options, [*self.settings, *own]))

        names = folder_names(self.axes, self.chosen)
        runs = {name: prepared(name, values) for name, values in zip(names, self.chosen, strict=True)}
        try:
            own = prepared(_OWN, ())
        except ConfigError:  # a config that needs the values of --over has none of its own
            return runs, ""
        if alike := [name for name, run in runs.items() if run.batch.config == own.batch.config]:
            return runs, alike[0]
        config = own.batch.config.model_dump(mode="json", by_alias=True)
        return {_OWN: own._replace(values=tuple(value_text(config, key) for key in self.axes)), **runs}, _OWN

    def _show_plan(self, runs: Mapping[str, _Run]) -> None:
        """Print what would be computed."""
        rows = []
        for name, run in runs.items():
            plan = plan_of(run.batch, run.scenes, run.options.output, run.options.execution)
            done = sum(row["status"] == DONE for row in plan["scenes"])
            rows.append({"run": name, "scenes": len(plan["scenes"]), "done": done, "refused": plan["refused"]})
        lines = [("run", "", "scenes", "done")]
        lines += [(row["run"], row["refused"], str(row["scenes"]), str(row["done"])) for row in rows]
        text = f"{aligned(lines)}\n\nnothing was computed\n"
        self.options.reporter.data(to_json({"command": self.command, "runs": rows}) if self.options.json else text)


def _compared(section: Section, axes: Axes, tried: Mapping[str, Combination], own_run: str) -> Row:
    """Return the runs of one data set by their figure, with the effect of every key.

    ``tried`` has a run's value of every key; ``own_run`` is the run that has the config's own values, or empty.
    """
    headline = section.protocol.headline
    figures = {run: section.overall(run).value for run in tried}
    order = sorted(tried, key=lambda run: (math.isnan(figures[run]), headline.sign * figures[run]))
    where = {"data_set": section.data_set, "protocol": section.protocol.name}
    rows: list[Row] = []
    for run in order:
        row = {**where, "run": run, **dict(zip(axes, tried[run], strict=True)), headline.heading: figures[run]}
        own = {"missing": len(section.missing[run]), "own_values": run == own_run}
        rows.append(row | {"seconds": mean_of_known(result.seconds for result in section.results_of(run))} | own)
    found = effects(axes, {tried[run]: figures[run] for run in order if run != _OWN}, headline.larger_is_better)
    document: Row = {**where, "headline": headline.heading, "unit": headline.unit}
    document |= {"larger_is_better": headline.larger_is_better, "best": order[0], "runs": rows, "sensitivity": found}
    return document


def _text(section: Section, compared: Row) -> str:
    """Return the comparison of the runs of one data set as two tables."""
    headline, rows = section.protocol.headline, compared["runs"]
    title = f"{section.data_set} - {section.protocol.presentation.title}, mean of {len(section.scenes)} scenes"
    more = f"; the first {_MAX_SHOWN} of {len(rows)}" if len(rows) > _MAX_SHOWN else ""
    best = tuple(
        (f"{row['run']} *" if row["own_values"] else row["run"], Number(row[headline.heading]), Number(row["seconds"]))
        for place, row in enumerate(rows)
        if place < _MAX_SHOWN or row["own_values"]
    )
    note = "*: the config's own values" if any(row["own_values"] for row in rows) else ""
    runs = Table(f"{title}: the best first{more}", ("run", headline.heading_with_unit, "seconds"), best, note)
    lines: list[tuple[str, ...]] = []
    for effect in compared["sensitivity"]:
        of_key = effect["key"], Number(effect["spread"]), Number(100 * effect["share_of_variance"], 0)
        for place, row in enumerate(effect["values"]):
            key, *spread = of_key if place == 0 else ("", "", "")
            lines.append((key, row["value"], str(row["runs"]), Number(row["mean"]), Number(row["best"]), *spread))
    header = ("key", "value", "runs", f"mean {headline.heading_with_unit}", "best", "spread of means", "% of variance")
    note = "spread: largest difference of the means; % of variance: the share that the key explains alone"
    keys = Table("Sensitivity, the strongest first", header, tuple(lines), note)
    return f"{runs.text()}\n{keys.text()}"
