"""Combinations of settings: parsed, drawn and named, and the effect of every key on the results."""

from __future__ import annotations

import hashlib
import itertools
import json
import math
import random
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from typing import Any

from depthcli.core.errors import ConfigError
from depthcli.run.json_csv import Row

Combination = tuple[str, ...]
"""A value, as text, for every key."""

_MAX_VALUES = 10_000  # of one key
_MAX_RUNS = 100_000
_MAX_NAME_LENGTH = 120  # characters of a folder's name; file systems take 255
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"


@dataclass(frozen=True)
class Axis:
    """One key and its values, as texts for ``--set``."""

    key: str
    values: tuple[str, ...]


def parse_axis(text: str) -> Axis:
    """Return key and values of ``key=2,4,8``, ``key=20:40:5`` (20, 25 ... 40) or ``key=[9,7],[11,9]``.

    Raises
    ------
    ConfigError
        Not of that form, or the same value twice.
    """
    key, equals, rest = text.partition("=")
    key, rest = key.strip(), rest.strip()
    if not equals or not key or not rest:
        raise ConfigError(f"--over {text}: must be KEY=VALUE,VALUE... or KEY=FIRST:LAST:STEP")
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
    if not 1 <= count <= _MAX_VALUES:
        raise ConfigError(f"--over {text}: no numbers from {rest.replace(':', ', ')} (FIRST:LAST:STEP, at most "
                          f"{_MAX_VALUES})")  # fmt: skip
    return [f"{(first + k * step).normalize():f}" for k in range(count)]


def _split(text: str) -> list[str]:
    """Return the parts between commas, except for those in brackets."""
    parts, depth = [""], 0
    for char in text:
        depth += (char in "[{") - (char in "]}")
        if char == "," and depth <= 0:
            parts.append("")
        else:
            parts[-1] += char
    return [part.strip() for part in parts]


def combinations(axes: Sequence[Axis], drawn: int | None = None, seed: int = 0) -> list[Combination]:
    """Return all combinations, the last key changing fastest, or ``drawn`` random ones in the same order.

    A larger ``drawn`` with the same seed gives the same combinations and more, so that a sweep can be extended.

    Raises
    ------
    ConfigError
        A key twice, or too many combinations.
    """
    keys = [axis.key for axis in axes]
    if len(set(keys)) < len(keys):
        raise ConfigError("--over: the same key twice")
    total = math.prod(len(axis.values) for axis in axes)
    if min(total, drawn or total) > _MAX_RUNS:
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
    """Return a folder name per combination, such as ``p2=4,window=9-7``; keys are as short as they can be."""
    short = [_shortest(axis.key, [other.key for other in axes]) for axis in axes]
    texts = [",".join(f"{key}={_plain(value)}" for key, value in zip(short, values, strict=True)) for values in chosen]
    names = []
    for text, values in zip(texts, chosen, strict=True):
        if texts.count(text) > 1 or len(text) > _MAX_NAME_LENGTH:
            # The suffix depends on the values alone, so that an extended sweep finds its earlier runs.
            suffix = hashlib.sha256("\0".join(values).encode()).hexdigest()[:8]
            text = f"{text[: _MAX_NAME_LENGTH - 12]}-{suffix}"
        names.append(text)
    return names


def _shortest(key: str, keys: Sequence[str]) -> str:
    parts = key.split(".")
    tails = [".".join(parts[-n:]) for n in range(1, len(parts) + 1)]
    return next(tail for tail in tails if sum(f".{other}".endswith(f".{tail}") for other in keys) == 1)


def _plain(value: str) -> str:
    return re.sub(r"[^\w.+-]+", "-", value).strip("-") or "empty"


def value_text(config: Mapping[str, Any], key: str) -> str:
    """Return a resolved config's value of a key as the text that sets it; empty where the config has no such key."""
    value: Any = config
    for part in key.split("."):
        try:
            value = value[int(part) if isinstance(value, list) else part]
        except (KeyError, IndexError, TypeError, ValueError):
            return ""
    return value if isinstance(value, str) else json.dumps(value, separators=(",", ":"))


@dataclass(frozen=True)
class Effect:
    """The effect of one key on the number by which runs are compared.

    Attributes
    ----------
    key : the key
    means : value -> mean figure of the runs that have it
    best : value -> best figure of the runs that have it
    runs : value -> number of them
    spread : largest difference between the means
    share : share of the figures' variance that the means explain (first-order effect), 0 to 1; NaN without variance
    """

    key: str
    means: dict[str, float]
    best: dict[str, float]
    runs: dict[str, int]
    spread: float
    share: float


def effects(axes: Sequence[Axis], figures: Mapping[Combination, float], larger_is_better: bool = False) -> list[Effect]:
    """Return the effect of every key, the strongest first; runs whose figure is NaN are left out."""
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


def document_of(effect: Effect) -> Row:
    """Return an effect as a JSON document."""
    values = [
        {"value": value, "runs": effect.runs[value], "mean": mean, "best": effect.best[value]}
        for value, mean in effect.means.items()
    ]
    return {"key": effect.key, "spread": effect.spread, "share_of_variance": effect.share, "values": values}
