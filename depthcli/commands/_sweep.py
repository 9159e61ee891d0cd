"""What ``sweep`` computes: a run of every combination of settings, and their comparison."""

from __future__ import annotations

import contextlib
import hashlib
import itertools
import json
import math
import random
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from decimal import Decimal
from typing import Any, TypeAlias

from depthcli.commands import _fuse, _refine_kinect, _register_confidence, _stereo, _transparent
from depthcli.commands._batch import DONE, plan_of, run_batch
from depthcli.commands._evaluation import viewers
from depthcli.commands._options import RunOptions, SceneOptions
from depthcli.core.errors import SOME_FAILED, ConfigError
from depthcli.evaluation.comparison import Section
from depthcli.evaluation.evaluate import PAGE_FILE, evaluate_runs
from depthcli.evaluation.render import Number, Table
from depthcli.evaluation.statistics import mean_of_known
from depthcli.io.formats.files import write_text
from depthcli.io.walk import discover_scenes
from depthcli.run.batch import Batch
from depthcli.run.console import aligned
from depthcli.run.json_csv import Row, to_csv, to_json

Axes: TypeAlias = Mapping[str, Sequence[str]]
"""Config key -> its values, as texts for ``--set``."""

Combination: TypeAlias = tuple[str, ...]
"""A value for every key."""

_PREPARE: Mapping[str, Any] = {
    "stereo": _stereo.prepare,
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
_MAX_VALUES = 10_000  # of one key
_MAX_RUNS = 100_000
_MAX_NAME_LENGTH = 120  # characters of a folder's name; file systems take 255
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,3})?"


def parse_axes(texts: Sequence[str]) -> dict[str, list[str]]:
    """Return keys and values of ``key=2,4,8``, ``key=20:40:5`` (20, 25 ... 40) and ``key=[9,7],[11,9]``.

    Raises
    ------
    ConfigError
        Not of that form, or the same key or value twice.
    """
    axes: dict[str, list[str]] = {}
    for text in texts:
        key, _, rest = (part.strip() for part in text.partition("="))
        if not key or not rest:
            raise ConfigError(f"--over {text}: must be KEY=VALUE,VALUE... or KEY=FIRST:LAST:STEP")
        if re.fullmatch(rf"{_NUMBER}(?::{_NUMBER}){{2}}", rest):
            first, last, step = map(Decimal, rest.split(":"))
            count = int((last - first) / step) + 1 if step else 0
            if not 1 <= count <= _MAX_VALUES:
                raise ConfigError(f"--over {text}: no numbers from FIRST:LAST:STEP, or more than {_MAX_VALUES}")
            values = [f"{(first + k * step).normalize():f}" for k in range(count)]
        else:
            parts, depth = [""], 0
            for char in rest:
                depth += (char in "[{") - (char in "]}")
                if char == "," and depth <= 0:
                    parts.append("")
                else:
                    parts[-1] += char
            values = [part.strip() for part in parts]
        if key in axes or not all(values) or len(set(values)) < len(values):
            raise ConfigError(f"--over {text}: an empty value, or the same key or value twice")
        axes[key] = values
    return axes


def combinations(axes: Axes, drawn: int | None = None, seed: int = 0) -> list[Combination]:
    """Return all combinations, the last key changing fastest, or ``drawn`` random ones in the same order.

    A larger ``drawn`` with the same seed gives the same combinations and more, so that a sweep can be extended.
    ConfigError where there are too many.
    """
    total = math.prod(map(len, axes.values()))
    if min(total, drawn or total) > _MAX_RUNS:
        raise ConfigError(f"--over: {min(total, drawn or total)} combinations; draw fewer with --random N")
    if drawn is None or drawn >= total:
        return list(itertools.product(*axes.values()))
    generator, chosen = random.Random(seed), dict[int, None]()
    while len(chosen) < drawn:
        chosen[generator.randrange(total)] = None
    found = []
    for number in sorted(chosen):
        values: Combination = ()
        for each in reversed(list(axes.values())):
            number, place = divmod(number, len(each))
            values = (each[place], *values)
        found.append(values)
    return found


def folder_names(axes: Axes, chosen: Sequence[Combination]) -> list[str]:
    """Return a folder name per combination, such as ``p2=4,window=9-7``; keys are as short as they can be."""
    short = []
    for key in axes:
        parts = key.split(".")
        tails = [".".join(parts[-n:]) for n in range(1, len(parts) + 1)]
        short.append(next(t for t in tails if sum(f".{other}".endswith(f".{t}") for other in axes) == 1))
    plain = [[re.sub(r"[^\w.+-]+", "-", value).strip("-") or "empty" for value in values] for values in chosen]
    names = [",".join(f"{key}={value}" for key, value in zip(short, values, strict=True)) for values in plain]
    counts = Counter(names)
    for place, (name, values) in enumerate(zip(names, chosen, strict=True)):
        if counts[name] > 1 or len(name) > _MAX_NAME_LENGTH:
            # The suffix depends on the values alone, so that an extended sweep finds its earlier runs.
            suffix = hashlib.sha256("\0".join(values).encode()).hexdigest()[:8]
            names[place] = f"{name[: _MAX_NAME_LENGTH - 12]}-{suffix}"
    return names


def value_text(config: Mapping[str, Any], key: str) -> str:
    """Return a resolved config's value of a key as the text that sets it; empty where the config has no such key."""
    value: Any = config
    for part in key.split("."):
        try:
            value = value[int(part) if isinstance(value, list) else part]
        except (KeyError, IndexError, TypeError, ValueError):
            return ""
    return value if isinstance(value, str) else json.dumps(value, separators=(",", ":"))


def effects(axes: Axes, figures: Mapping[Combination, float], larger_is_better: bool = False) -> list[Row]:
    """Return the effect of every key on the figure, the strongest first; runs whose figure is NaN are left out.

    Returns
    -------
    Rows with ``key``; ``spread``, the largest difference between the means of its values; ``share_of_variance`` of the
    figures that these means explain (first-order effect), 0 to 1; ``values``: ``value``, ``runs``, ``mean``, ``best``.
    """
    known = {values: figure for values, figure in figures.items() if not math.isnan(figure)}
    whole = math.fsum(known.values()) / len(known) if known else math.nan
    variance = math.fsum((figure - whole) ** 2 for figure in known.values())
    found: list[Row] = []
    for number, key in enumerate(axes):
        rows: list[Row] = []
        for value in axes[key]:
            if group := [figure for values, figure in known.items() if values[number] == value]:
                best = max(group) if larger_is_better else min(group)
                rows.append({"value": value, "runs": len(group), "mean": math.fsum(group) / len(group), "best": best})
        means = [row["mean"] for row in rows]
        between = math.fsum(row["runs"] * (row["mean"] - whole) ** 2 for row in rows)
        share = between / variance if variance > 0 else math.nan
        spread = max(means) - min(means) if means else math.nan
        found.append({"key": key, "spread": spread, "share_of_variance": share, "values": rows})
    return sorted(found, key=lambda row: math.inf if math.isnan(row["spread"]) else -row["spread"])


def run_sweep(
    command: str, config: str, source: SceneOptions, options: RunOptions, settings: Sequence[str], axes: Axes,
    chosen: Sequence[Combination], html: bool, html_budget: str,
) -> int:  # fmt: skip
    """Run the combinations, each in a folder of its own, evaluate all runs, and return the exit code.

    Raises
    ------
    ConfigError
        A config, key or value is wrong; nothing was computed.
    """
    if command not in _PREPARE:
        raise ConfigError(f"--command: must be one of {', '.join(_PREPARE)} (got {command!r})")
    output, reporter = options.output, options.reporter

    def prepared(name: str, values: Sequence[str]) -> tuple[RunOptions, Batch[Any], list[Any]]:
        run = replace(options, output=output / _RUNS / name, json=False, quiet=True, flag=None, fail_flagged=False)
        own = [(f"--over {key}", f"{key}={value}") for key, value in zip(axes, values, strict=False)]
        return run, *_PREPARE[command](config, source, run, [*settings, *own])

    tried = dict(zip(folder_names(axes, chosen), chosen, strict=True))
    runs, own_run = {name: prepared(name, values) for name, values in tried.items()}, ""
    with contextlib.suppress(ConfigError):  # a config that needs the values of --over has none of its own
        own = prepared(_OWN, ())
        own_run = next((name for name, (_, batch, _) in runs.items() if batch.config == own[1].config), _OWN)
        if own_run == _OWN:
            values = own[1].config.model_dump(mode="json", by_alias=True)
            tried[_OWN] = tuple(value_text(values, key) for key in axes)
            runs = {_OWN: own, **runs}
    if options.dry_run:
        rows = []
        for name, (run, batch, scenes) in runs.items():
            plan = plan_of(batch, scenes, run.output, run.execution)
            done = sum(row["status"] == DONE for row in plan["scenes"])
            rows.append({"run": name, "scenes": len(plan["scenes"]), "done": done, "refused": plan["refused"]})
        lines = [("run", "", "scenes", "done")]
        lines += [(row["run"], row["refused"], str(row["scenes"]), str(row["done"])) for row in rows]
        text = f"{aligned(lines)}\n\nnothing was computed\n"
        reporter.data(to_json({"command": command, "runs": rows}) if options.json else text)
        return 0
    for table in _TABLES:
        if (output / table).exists() and not (output / _RUNS).is_dir():
            raise ConfigError(f"{output / table}: is no sweep's; move it away, or choose another --output")
    failed = False
    for count, (name, (run, batch, scenes)) in enumerate(runs.items(), 1):
        reporter.info(f"run {count} of {len(runs)}: {name}")
        failed |= run_batch(batch, scenes, run, source) != 0
    assert source.input is not None
    if not any(scene.has_truth for scene in discover_scenes(source.input, None, source.layout, source.patterns)):
        reporter.info(f"{source.input}: no ground truth there, the runs are not compared")
        return SOME_FAILED if failed else 0
    report = evaluate_runs(
        [output / _RUNS / name for name in runs], source.input, output / "evaluation", source.patterns, source.layout,
        reporter=reporter, viewers=viewers(reporter, output / "evaluation", html, html_budget),
    )  # fmt: skip
    results = [_compared(section, report.runs, axes, tried, own_run) for section in report.sections]
    document = to_json({"over": dict(axes), "results": [result for result, _ in results]})
    write_text(output / _TABLES[0], document)
    write_text(output / _TABLES[1], to_csv([row for result, _ in results for row in result["runs"]]))
    if options.json:
        reporter.data(document)
    elif not options.quiet:
        reporter.data("\n".join(text for _, text in results))
    reporter.info(f"runs, evaluation, sweep.csv and sweep.json in {output}")
    if html:
        reporter.info(f"page to open in a browser: {output / 'evaluation' / PAGE_FILE}")
    return SOME_FAILED if failed or report.failed else 0


def _compared(
    section: Section, names: Sequence[str], axes: Axes, tried: Mapping[str, Combination], own_run: str
) -> tuple[Row, str]:
    """Return the runs of one data set by their figure with the effect of every key, as a document and as text.

    ``tried`` has a run's value of every key; ``own_run`` is the run that has the config's own values, or empty.
    """
    headline = section.protocol.headline
    figures = {run: section.overall(run).value for run in names}
    seconds = {run: mean_of_known(result.seconds for result in section.results_of(run)) for run in names}
    order = sorted(names, key=lambda run: (math.isnan(figures[run]), headline.sign * figures[run]))
    found = effects(axes, {tried[run]: figures[run] for run in order if run != _OWN}, headline.larger_is_better)
    where = {"data_set": section.data_set, "protocol": section.protocol.name}
    rows: list[Row] = []
    for run in order:
        row = {**where, "run": run, **dict(zip(axes, tried[run], strict=True)), headline.heading: figures[run]}
        own = {"missing": len(section.missing[run]), "own_values": run == own_run}
        rows.append(row | {"seconds": seconds[run]} | own)
    document: Row = {**where, "headline": headline.heading, "unit": headline.unit}
    document |= {"larger_is_better": headline.larger_is_better, "best": order[0], "runs": rows, "sensitivity": found}

    what = headline.heading_with_unit
    title = f"{section.data_set} - {section.protocol.presentation.title}, mean of {len(section.scenes)} scenes"
    more = f"; the first {_MAX_SHOWN} of {len(order)}" if len(order) > _MAX_SHOWN else ""
    best = tuple(
        (f"{run} *" if run == own_run else run, Number(figures[run]), Number(seconds[run]))
        for place, run in enumerate(order)
        if place < _MAX_SHOWN or run == own_run
    )
    runs = Table(
        f"{title}: the best first{more}",
        ("run", what, "seconds"),
        best,
        "*: the config's own values" if own_run else "",
    )
    lines: list[tuple[str, ...]] = []
    for effect in found:
        of_key = effect["key"], Number(effect["spread"]), Number(100 * effect["share_of_variance"], 0)
        for place, row in enumerate(effect["values"]):
            key, *spread = of_key if place == 0 else ("", "", "")
            lines.append((key, row["value"], str(row["runs"]), Number(row["mean"]), Number(row["best"]), *spread))
    header = ("key", "value", "runs", f"mean {what}", "best", "spread of means", "% of variance")
    note = "spread: largest difference of the means; % of variance: what the key explains alone"
    keys = Table("Sensitivity, the strongest first", header, tuple(lines), note)
    return document, f"{runs.text()}\n{keys.text()}"
