"""What ``sweep`` computes: a run of every combination of settings, and their comparison."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from pydantic import BaseModel

from depthcli.commands import _fuse, _pairs, _refine_kinect, _register_confidence, _transparent
from depthcli.commands._batch import DONE, plan_of, run_batch
from depthcli.commands._evaluation import viewers
from depthcli.commands._options import RunOptions, SceneOptions
from depthcli.core.errors import ConfigError
from depthcli.evaluation.comparison import EvaluationReport, Section
from depthcli.evaluation.evaluate import PAGE_FILE, evaluate_runs
from depthcli.evaluation.render import Number, Table
from depthcli.evaluation.statistics import mean_of_known
from depthcli.io.formats.files import write_text
from depthcli.io.walk import discover_scenes
from depthcli.run.batch import SOME_FAILED, Batch
from depthcli.run.combinations import (
    Axis,
    Combination,
    Effect,
    combinations,
    document_of,
    effects,
    folder_names,
    parse_axis,
    value_text,
)
from depthcli.run.console import aligned
from depthcli.run.json_csv import Row, to_csv, to_json

_PREPARE: Mapping[str, Any] = {
    "stereo": _pairs.prepare,
    "fuse": _fuse.prepare,
    "refine-kinect": _refine_kinect.prepare,
    "transparent": _transparent.prepare,
    "register-confidence": _register_confidence.prepare,
}
"""Command -> what returns its batch and scenes for a config."""

_RUNS = "runs"  # the folder with one run folder per combination
_OWN = "own-values"  # name of the run of the config as it is
_TABLES = ("sweep.json", "sweep.csv")
_MAX_SHOWN = 20  # runs in the printed table; files hold all


@dataclass(frozen=True)
class Sweep:
    """Runs of one config with many settings.

    Attributes
    ----------
    command, config : the command, and its CONFIG argument
    source : the folder of scenes
    options : of every run, and the folder that all runs go to
    settings : values of ``--set``, of all runs
    """

    command: str
    config: str
    source: SceneOptions
    options: RunOptions
    settings: Sequence[str]

    def run(self, over: Sequence[str], drawn: int | None, seed: int, html: bool, html_budget: str) -> int:
        """Run every combination, evaluate all runs, and return the exit code.

        Raises
        ------
        ConfigError
            A config, key or value is wrong; nothing was computed.
        """
        if self.command not in _PREPARE:
            raise ConfigError(f"--command: must be one of {', '.join(_PREPARE)} (got {self.command!r})")
        options, own_run = self.options, ""
        axes = [parse_axis(text) for text in over]
        chosen = combinations(axes, drawn, seed)
        names = folder_names(axes, chosen)
        batches = {
            name: self._batch(name, [(f"--over {a.key}", f"{a.key}={v}") for a, v in zip(axes, values, strict=True)])
            for name, values in zip(names, chosen, strict=True)
        }
        tried = dict(zip(names, chosen, strict=True))
        with contextlib.suppress(ConfigError):  # a config that needs the values of --over has none of its own
            own = self._batch(_OWN, [])
            if own[0].config not in [batch.config for batch, _ in batches.values()]:
                batches = {_OWN: own, **batches}
                assert isinstance(own[0].config, BaseModel)
                values = own[0].config.model_dump(mode="json", by_alias=True)
                tried[_OWN] = tuple(value_text(values, axis.key) for axis in axes)
            own_run = next(name for name, (batch, _) in batches.items() if batch.config == own[0].config)
        if options.dry_run:
            return self._print_plan(batches)
        for table in _TABLES:
            if (options.output / table).exists() and not (options.output / _RUNS).is_dir():
                raise ConfigError(f"{options.output / table}: is no sweep's; move it away, or choose another --output")
        failed = False
        for number, (name, (batch, scenes)) in enumerate(batches.items(), 1):
            options.reporter.info(f"run {number} of {len(batches)}: {name}")
            failed |= run_batch(batch, scenes, self._own_options(name), self.source) != 0
        report = self._evaluated(list(batches), html, html_budget)
        if report is not None:
            _print_result(axes, tried, own_run, report, options)
            failed |= bool(report.failed)
            if html:
                options.reporter.info(f"page to open in a browser: {options.output / 'evaluation' / PAGE_FILE}")
        return SOME_FAILED if failed else 0

    def _own_options(self, name: str) -> RunOptions:
        folder = self.options.output / _RUNS / name
        return replace(self.options, output=folder, json=False, quiet=True, flag=None, fail_flagged=False)

    def _batch(self, name: str, settings: Sequence[tuple[str, str]]) -> tuple[Batch[Any], list[Any]]:
        found: tuple[Batch[Any], list[Any]] = _PREPARE[self.command](
            self.config, self.source, self._own_options(name), [*self.settings, *settings]
        )
        return found

    def _print_plan(self, batches: Mapping[str, tuple[Batch[Any], list[Any]]]) -> int:
        rows = []
        for name, (batch, scenes) in batches.items():
            options = self._own_options(name)
            plan = plan_of(batch, scenes, options.output, options.execution)
            done = sum(row["status"] == DONE for row in plan["scenes"])
            rows.append({"run": name, "scenes": len(plan["scenes"]), "done": done, "refused": plan["refused"]})
        if self.options.json:
            self.options.reporter.data(to_json({"command": self.command, "runs": rows}))
        else:
            lines = [("run", "", "scenes", "done")]
            lines += [(r["run"], r["refused"], str(r["scenes"]), str(r["done"])) for r in rows]
            self.options.reporter.data(aligned(lines) + "\n\nnothing was computed\n")
        return 0

    def _evaluated(self, names: Sequence[str], html: bool, html_budget: str) -> EvaluationReport | None:
        source, reporter, target = self.source, self.options.reporter, self.options.output / "evaluation"
        assert source.input is not None
        scenes = discover_scenes(source.input, None, source.layout, source.patterns)
        if not any(scene.has_truth for scene in scenes):
            reporter.info(f"{source.input}: no ground truth there, the runs are not compared")
            return None
        runs = [self.options.output / _RUNS / name for name in names]
        return evaluate_runs(
            runs, source.input, target, source.patterns, source.layout, reporter=reporter,
            viewers=viewers(reporter, target, html, html_budget),
        )  # fmt: skip


def _print_result(
    axes: Sequence[Axis],
    tried: Mapping[str, Combination],
    own_run: str,
    report: EvaluationReport,
    options: RunOptions,
) -> None:
    """Print the runs by their figure and the effect of every key; write both to ``sweep.csv`` and ``sweep.json``.

    Parameters
    ----------
    tried : run -> its value of every key
    own_run : the run that has the config's own values, or empty
    """
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
        write_text(options.output / name, text)
    if options.json:
        options.reporter.data(to_json(document))
    elif not options.quiet:
        options.reporter.data("\n".join(texts))
    options.reporter.info(f"runs, evaluation, sweep.csv and sweep.json in {options.output}")


def _text(
    section: Section, order: Sequence[str], own_run: str, figures: Mapping[str, float], found: Sequence[Effect]
) -> str:
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
