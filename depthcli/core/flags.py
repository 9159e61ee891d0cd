"""Flags: the rows of a report that a condition such as ``measured<0.6`` holds for, so that a person looks at them."""

from __future__ import annotations

import difflib
import math
import operator
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from depthcli.core.errors import ConfigError

_COMPARISONS = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "=": operator.eq,
    "!=": operator.ne,
}
_CONDITION = re.compile(r"\s*([^<>=!]+?)\s*(<=|>=|!=|<|>|=)\s*([^\s<>=!]+)\s*")
_NUMBER = re.compile(r"\d+\.?\d*|\.\d+")
_COLUMNS = {"memory": "peak_memory"}  # as the printed table names them


@dataclass(frozen=True)
class Condition:
    """A column compared with a number, such as ``measured<0.6`` or ``bad 1 nonocc>8``."""

    column: str
    comparison: str
    limit: float

    @classmethod
    def of(cls, text: str) -> Condition:
        """Return the condition that a text means; ConfigError if it means none."""
        found = _CONDITION.fullmatch(text)
        try:
            column, comparison, limit = found.groups() if found else ("", "", "nan")
            number = float(limit)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise ConfigError(f"--flag: expected COLUMN<NUMBER, or > <= >= = !=, such as 'measured<0.6' (got {text!r})")
        return cls(_COLUMNS.get(column, plain_name(column)), comparison, number)

    def __str__(self) -> str:
        return f"{self.column}{self.comparison}{self.limit:g}"


@dataclass(frozen=True)
class Flagged:
    """A flagged row: its scene, its run (empty if there is only one), and the conditions that hold, with its values."""

    scene: str
    run: str
    reasons: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return plain values, for JSON."""
        return {"scene": self.scene, **({"run": self.run} if self.run else {}), "reasons": list(self.reasons)}


@dataclass(frozen=True)
class Flags:
    """The result of all conditions.

    Attributes
    ----------
    conditions : as texts; none: nothing was requested
    flagged : rows for which a condition holds, worst first
    n_rows : number of rows
    warnings : lines on conditions for which some rows have no value
    unanswered : lines on conditions for which no row has a value, perhaps because the column is misspelled
    """

    conditions: tuple[str, ...] = ()
    flagged: tuple[Flagged, ...] = ()
    n_rows: int = 0
    warnings: tuple[str, ...] = ()
    unanswered: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return plain values, for JSON; nothing without conditions."""
        return {"flagged": [each.to_dict() for each in self.flagged]} if self.conditions else {}

    def text(self) -> str:
        """Return the number of flagged rows and a table of them, for a terminal."""
        lines = [f"flagged: {len(self.flagged) or 'none'} of {self.n_rows}"]
        names = [name for name in ("scene", "run") if any(getattr(each, name) for each in self.flagged)]
        rows = [[*(getattr(each, name) for name in names), "; ".join(each.reasons)] for each in self.flagged]
        table = [[*names, "why"], *rows] if rows else []
        widths = [max(map(len, column)) for column in zip(*table, strict=True)]
        lines += ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in table]
        return "\n" + "".join(f"{line.rstrip()}\n" for line in lines)


def flag_rows(conditions: Sequence[Condition], rows: Sequence[Mapping[str, Any]]) -> Flags:
    """Return the rows that the conditions flag: most reasons first, then the farthest beyond their first limit.

    Parameters
    ----------
    rows : column -> value; each has a ``scene``, and may have a ``run``
    """
    reasons: list[list[str]] = [[] for _ in rows]
    distances: list[list[float]] = [[] for _ in rows]
    warnings, unanswered = [], []
    for condition in conditions:
        values = [_number(row.get(condition.column)) for row in rows]
        n_known = sum(value is not None for value in values)
        if not n_known:
            columns = dict.fromkeys(key for row in rows for key, value in row.items() if _number(value) is not None)
            near = difflib.get_close_matches(condition.column, columns, 1, 0.7)
            meant = f"; did you mean {near[0]!r}?" if near else ""
            unanswered.append(f"--flag {condition}: no row has a value for {condition.column!r}{meant}")
        elif n_known < len(rows):
            warnings.append(f"--flag {condition}: {len(rows) - n_known} of {len(rows)} rows have no value")
        for k, value in enumerate(values):
            if value is not None and _COMPARISONS[condition.comparison](value, condition.limit):
                reasons[k].append(f"{condition.column} {value:.4g} {condition.comparison} {condition.limit:g}")
                distances[k].append(abs(value - condition.limit))
    worst = sorted((k for k in range(len(rows)) if reasons[k]), key=lambda k: (-len(reasons[k]), -distances[k][0]))
    flagged = tuple(Flagged(str(rows[k]["scene"]), str(rows[k].get("run", "")), tuple(reasons[k])) for k in worst)
    return Flags(tuple(map(str, conditions)), flagged, len(rows), tuple(warnings), tuple(unanswered))


def plain_name(heading: str) -> str:
    """Return a heading with single spaces and the shortest form of its numbers: ``bad 1.0`` is ``bad 1``."""
    return " ".join(f"{float(word):g}" if _NUMBER.fullmatch(word) else word for word in heading.split())


def _number(value: Any) -> float | None:
    """Return a finite number, the sum of seconds by stage, and None for everything else."""
    if isinstance(value, Mapping):
        return math.fsum(value.values()) if value else None
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return None
    return float(value)
