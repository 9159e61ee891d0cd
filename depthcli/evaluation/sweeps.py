"""Sweeps: the combinations of settings, the names of their runs, the comparison, and the effect of every key."""

from __future__ import annotations

import hashlib
import itertools
import json
import math
import random
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from decimal import Decimal
from typing import Any, TypeAlias

from depthcli.core.errors import ConfigError
from depthcli.evaluation.comparison import Section
from depthcli.evaluation.statistics import mean_of_known
from depthcli.show.table import Number, Row, Table

Axes: TypeAlias = Mapping[str, Sequence[str]]
"""Config key -> its values, as texts for ``--set``."""

Combination: TypeAlias = tuple[str, ...]
"""A value for every key."""

_MAX_VALUES = 10_000  # of one key
_MAX_RUNS = 100_000
_MAX_NAME_LENGTH = 120  # characters of a folder's name; file systems take 255
OWN_VALUES = "own-values"  # name of the run of the config as it is
_MAX_SHOWN = 20  # runs in the printed table; files list all
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,3})?"


def parse_axes(texts: Sequence[str]) -> dict[str, list[str]]:
    """Return keys and values of ``key=2,4,8``, ``key=20:40:5`` (20, 25 ... 40) and ``key=[9,7],[11,9]``.

    Raises
    ------
    ConfigError
        A text has another form, or a key or value occurs twice.
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

    With the same seed, a larger ``drawn`` adds combinations to the same ones, so that a sweep can be extended.
    Raise ConfigError if there are too many.
    """
    total = math.prod(map(len, axes.values()))
    if min(total, drawn or total) > _MAX_RUNS:
        raise ConfigError(f"--over: {min(total, drawn or total)} combinations; draw fewer with --random N")
    if drawn is None or drawn >= total:
        return list(itertools.product(*axes.values()))
    generator, chosen = random.Random(seed), dict[int, None]()
    while len(chosen) < drawn:
        chosen[generator.randrange(total)] = None
    drawn_values = []
    for number in sorted(chosen):
        values: Combination = ()
        for choices in reversed(list(axes.values())):
            number, place = divmod(number, len(choices))
            values = (choices[place], *values)
        drawn_values.append(values)
    return drawn_values


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
    """Return the value of a key in a resolved config as text for ``--set``; empty if there is no such key."""
    value: Any = config
    for part in key.split("."):
        try:
            value = value[int(part) if isinstance(value, list) else part]
        except (KeyError, IndexError, TypeError, ValueError):
            return ""
    return value if isinstance(value, str) else json.dumps(value, separators=(",", ":"))


def compared(section: Section, axes: Axes, tried: Mapping[str, Combination], own_run: str) -> Row:
    """Return the runs of one data set, the best first, and the effect of every key.

    ``tried`` has a run's value of every key; ``own_run`` is the run that has the config's own values, or empty.
    """
    headline = section.protocol.headline
    figures = {run: section.overall(run).value for run in tried}
    order = sorted(tried, key=lambda run: (math.isnan(figures[run]), headline.sign * figures[run]))
    where = {"data_set": section.data_set, "protocol": section.protocol.name}
    rows: list[Row] = []
    for run in order:
        row = {**where, "run": run, **dict(zip(axes, tried[run], strict=True)), headline.heading: figures[run]}
        facts = {"missing": len(section.missing[run]), "own_values": run == own_run}
        rows.append(row | {"seconds": mean_of_known(result.seconds for result in section.results_of(run))} | facts)
    combined = {tried[run]: figures[run] for run in order if run != OWN_VALUES}
    return {
        **where,
        "headline": headline.heading,
        "unit": headline.unit,
        "larger_is_better": headline.larger_is_better,
        "best": order[0],
        "runs": rows,
        "sensitivity": effects(axes, combined, headline.larger_is_better),
    }


def effects(axes: Axes, figures: Mapping[Combination, float], larger_is_better: bool = False) -> list[Row]:
    """Return the effect of every key on the figure, the strongest first; runs without a figure are left out.

    Returns
    -------
    Rows with ``key``; ``spread``, the largest difference between the means of its values; ``share_of_variance`` of the
    figures that these means explain (first-order effect), 0 to 1; ``values``: ``value``, ``runs``, ``mean``, ``best``.
    """
    known = {values: figure for values, figure in figures.items() if not math.isnan(figure)}
    whole = math.fsum(known.values()) / len(known) if known else math.nan
    variance = math.fsum((figure - whole) ** 2 for figure in known.values())
    effect_rows: list[Row] = []
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
        effect_rows.append({"key": key, "spread": spread, "share_of_variance": share, "values": rows})
    return sorted(effect_rows, key=lambda row: math.inf if math.isnan(row["spread"]) else -row["spread"])


def text_of(section: Section, comparison: Row) -> str:
    """Return the comparison of the runs of one data set as two tables."""
    headline, rows = section.protocol.headline, comparison["runs"]
    presentation = section.protocol.presentation
    title = f"{section.data_set} - {presentation.title}, {presentation.mean_heading} of {len(section.scenes)} scenes"
    more = f"; the first {_MAX_SHOWN} of {len(rows)}" if len(rows) > _MAX_SHOWN else ""
    best = tuple(
        (f"{row['run']} *" if row["own_values"] else row["run"], Number(row[headline.heading]), Number(row["seconds"]))
        for place, row in enumerate(rows)
        if place < _MAX_SHOWN or row["own_values"]
    )
    note = "*: the config's own values" if any(row["own_values"] for row in rows) else ""
    runs = Table.of_cells(f"{title}: the best first{more}", ("run", headline.heading_with_unit, "seconds"), best, note)
    lines: list[tuple[str, ...]] = []
    for effect in comparison["sensitivity"]:
        of_key = effect["key"], Number(effect["spread"]), Number(100 * effect["share_of_variance"], 0)
        for place, row in enumerate(effect["values"]):
            key, *spread = of_key if place == 0 else ("", "", "")
            lines.append((key, row["value"], str(row["runs"]), Number(row["mean"]), Number(row["best"]), *spread))
    header = ("key", "value", "runs", f"mean {headline.heading_with_unit}", "best", "spread of means", "% of variance")
    note = "spread: largest difference of the means; % of variance: the share that the key explains alone"
    keys = Table.of_cells("Sensitivity, the strongest first", header, tuple(lines), note)
    return f"{runs.text()}\n{keys.text()}"
