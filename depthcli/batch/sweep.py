"""Combinations of settings: parsed, drawn, named; and what their figures say about every key."""

from __future__ import annotations

import itertools
import math
import random
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from typing import Any

from depthcli.core.errors import ConfigError

Combination = tuple[str, ...]
"""A value, as text, for every key."""

_MOST_VALUES = 10_000
_MOST_RUNS = 100_000
_MOST_NAME = 120  # characters of a folder's name
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"


@dataclass(frozen=True)
class Axis:
    """One key and its values, as texts that ``--set`` takes."""

    key: str
    values: tuple[str, ...]


def parse_axis(text: str) -> Axis:
    """``key=2,4,8``, ``key=20:40:5`` (20, 25 ... 40) or ``key=[9,7],[11,9]``.

    Raises
    ------
    ConfigError
        Not of that form, or the same value twice.
    """
    key, equals, rest = text.partition("=")
    key, rest = key.strip(), rest.strip()
    if not equals or not key or not rest:
        raise ConfigError(f"--over {text}: want KEY=VALUE,VALUE... or KEY=FIRST:LAST:STEP")
    values = _range(text, rest) if re.fullmatch(rf"{_NUMBER}(?::{_NUMBER}){{2}}", rest) else _split(rest)
    if any(not value for value in values):
        raise ConfigError(f"--over {text}: an empty value")
    if len(set(values)) < len(values):
        raise ConfigError(f"--over {text}: the same value twice")
    return Axis(key, tuple(values))


def _range(text: str, rest: str) -> list[str]:
    try:
        first, last, step = (Decimal(part) for part in rest.split(":"))
        count = int((last - first) / step) + 1 if step else 0
    except (InvalidOperation, OverflowError):
        count = 0
    if not 1 <= count <= _MOST_VALUES:
        raise ConfigError(f"--over {text}: no numbers from {rest.replace(':', ', ')} (FIRST:LAST:STEP, at most "
                          f"{_MOST_VALUES})")  # fmt: skip
    return [f"{(first + k * step).normalize():f}" for k in range(count)]


def _split(text: str) -> list[str]:
    """At the commas that stand in no brackets."""
    parts, depth = [""], 0
    for char in text:
        depth += (char in "[{") - (char in "]}")
        if char == "," and depth <= 0:
            parts.append("")
        else:
            parts[-1] += char
    return [part.strip() for part in parts]


def combinations(axes: Sequence[Axis], drawn: int | None = None, seed: int = 0) -> list[Combination]:
    """All combinations, the last key changing fastest; or ``drawn`` different ones at random, in that order.

    More with the same seed are the same ones and others, so that a sweep can be extended.

    Raises
    ------
    ConfigError
        A key twice, or too many combinations.
    """
    keys = [axis.key for axis in axes]
    if len(set(keys)) < len(keys):
        raise ConfigError("--over: the same key twice")
    total = math.prod(len(axis.values) for axis in axes)
    if min(total, drawn or total) > _MOST_RUNS:
        raise ConfigError(f"--over: {min(total, drawn or total)} combinations; draw fewer with --random N")
    if drawn is None or drawn >= total:
        return list(itertools.product(*(axis.values for axis in axes)))
    generator, chosen = random.Random(seed), dict[int, None]()
    while len(chosen) < drawn:
        chosen[generator.randrange(total)] = None
    return [_at(axes, number) for number in sorted(chosen)]


def _at(axes: Sequence[Axis], number: int) -> Combination:
    values = []
    for axis in reversed(axes):
        number, place = divmod(number, len(axis.values))
        values.append(axis.values[place])
    return tuple(reversed(values))


def folder_names(axes: Sequence[Axis], chosen: Sequence[Combination]) -> list[str]:
    """A name for the run of every combination: ``p2=4,window=9-7``, with as much of the keys as tells them apart."""
    short = [_shortest(axis.key, [other.key for other in axes]) for axis in axes]
    names = [",".join(f"{key}={_plain(value)}" for key, value in zip(short, values, strict=True)) for values in chosen]
    return [
        # The mark is of the values themselves, so that a sweep with more of them finds its runs again.
        name if names.count(name) == 1 and len(name) <= _MOST_NAME else f"{name[: _MOST_NAME - 12]}-{_mark(values)}"
        for name, values in zip(names, chosen, strict=True)
    ]


def _shortest(key: str, keys: Sequence[str]) -> str:
    parts = key.split(".")
    tails = [".".join(parts[-n:]) for n in range(1, len(parts) + 1)]
    return next(tail for tail in tails if sum(f".{other}".endswith(f".{tail}") for other in keys) == 1)


def _plain(value: str) -> str:
    return re.sub(r"[^\w.+-]+", "-", value).strip("-") or "empty"


def _mark(values: Combination) -> str:
    from depthcli.batch.run_folder import digest

    return digest("\0".join(values).encode())[:8]


@dataclass(frozen=True)
class Effect:
    """What one key does to the figure.

    Attributes
    ----------
    key : the key
    means : value -> mean figure of the runs that have it
    best : value -> best figure of the runs that have it
    runs : value -> number of them
    spread : largest difference between the means
    share : of the figures' variance, that which the means explain (first-order effect), 0 to 1; NaN without any
    """

    key: str
    means: dict[str, float]
    best: dict[str, float]
    runs: dict[str, int]
    spread: float
    share: float


def effects(axes: Sequence[Axis], figures: Mapping[Combination, float], larger_is_better: bool = False) -> list[Effect]:
    """Every key's effect, the strongest first; runs without a figure (NaN) are left out."""
    known = {values: figure for values, figure in figures.items() if not math.isnan(figure)}
    whole = math.fsum(known.values()) / len(known) if known else math.nan
    variance = math.fsum((figure - whole) ** 2 for figure in known.values())
    found = []
    for number, axis in enumerate(axes):
        groups: dict[str, list[float]] = {}
        for values, figure in known.items():
            groups.setdefault(values[number], []).append(figure)
        means = {value: math.fsum(groups[value]) / len(groups[value]) for value in axis.values if value in groups}
        between = math.fsum(len(groups[value]) * (mean - whole) ** 2 for value, mean in means.items())
        best = {value: (max if larger_is_better else min)(groups[value]) for value in means}
        spread = max(means.values()) - min(means.values()) if means else math.nan
        share = between / variance if variance > 0 else math.nan
        found.append(Effect(axis.key, means, best, {v: len(groups[v]) for v in means}, spread, share))
    return sorted(found, key=lambda effect: -effect.spread if not math.isnan(effect.spread) else math.inf)


def document_of(effect: Effect) -> dict[str, Any]:
    """As plain values."""
    values = [
        {"value": value, "runs": effect.runs[value], "mean": mean, "best": effect.best[value]}
        for value, mean in effect.means.items()
    ]
    return {"key": effect.key, "spread": effect.spread, "share_of_variance": effect.share, "values": values}
