"""Flag the rows of a report that meet a condition such as ``measured<0.6``."""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from depthcli.core.errors import FLAGGED, ConfigError
from depthcli.core.text import did_you_mean
from depthcli.run.console import Reporter
from depthcli.show.table import aligned

_COMPARISONS = {"<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge}
_COMPARISONS |= {"=": operator.eq, "!=": operator.ne}
_CONDITION = re.compile(r"\s*([^<>=!]+?)\s*(<=|>=|!=|<|>|=)\s*([^\s<>=!]+)\s*")
_NUMBER = re.compile(r"\d+\.?\d*|\.\d+")
_COLUMNS = {"memory": "peak_memory"}  # name in the printed table -> column


class Condition(NamedTuple):
    """A column compared with a number, such as ``measured<0.6`` or ``bad 1 nonocc>8``."""

    column: str
    comparison: str
    limit: float

    def __str__(self) -> str:
        return f"{self.column}{self.comparison}{self.limit:g}"


def conditions_of(texts: Sequence[str] | None) -> list[Condition]:
    """Return the conditions in the texts. Raise ConfigError if one is wrong, or if there is none."""
    if not texts:
        raise ConfigError("--fail-flagged needs a condition, such as --flag 'measured<0.6'")
    made = []
    for text in texts:
        try:
            column, comparison, limit = found.groups() if (found := _CONDITION.fullmatch(text)) else ("", "", "nan")
            number = float(limit)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise ConfigError(f"--flag: expected COLUMN<NUMBER, or > <= >= = !=, such as 'measured<0.6' (got {text!r})")
        made.append(Condition(_COLUMNS.get(column, plain_name(column)), comparison, number))
    return made


class Flagged(NamedTuple):
    """A flagged row: its scene, its run (empty if there is only one), and the met conditions with values."""

    scene: str
    run: str
    reasons: tuple[str, ...]


class Flags(NamedTuple):
    """The result of all conditions."""

    conditions: tuple[str, ...] = ()
    flagged: tuple[Flagged, ...] = ()  # worst first
    n_rows: int = 0
    unanswered: tuple[str, ...] = ()  # conditions without a value in any row, e.g. a misspelled column

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {"flagged": [{k: v for k, v in each._asdict().items() if k != "run" or v} for each in self.flagged]}

    def text(self) -> str:
        """Return the number and table of flagged rows for a terminal."""
        names = [name for name in ("scene", "run") if any(getattr(each, name) for each in self.flagged)]
        rows = [(*(getattr(each, name) for name in names), "; ".join(each.reasons)) for each in self.flagged]
        table = [aligned([(*names, "why"), *rows], [False] * (len(names) + 1))] if rows else []
        return "\n".join(["", f"flagged: {len(rows) or 'none'} of {self.n_rows}", *table, ""])

    def exit_code(self, all_rows: bool = True) -> int:
        """Return the exit code by ``--fail-flagged``. Without ``all_rows``, other processes may have missing values."""
        return FLAGGED if self.flagged or (self.unanswered and all_rows) else 0


def flag_rows(conditions: Sequence[Condition], rows: Sequence[Mapping[str, Any]], reporter: Reporter) -> Flags:
    """Return the flagged rows, sorted by number of reasons, then by distance from the limit of the first reason.

    Rows have a ``scene`` and may have a ``run``. Warn about conditions without a value in some or all rows.
    """
    reasons: list[list[str]] = [[] for _ in rows]
    distances: list[list[float]] = [[] for _ in rows]
    unanswered = []
    for condition in conditions:
        values = [_number(row.get(condition.column)) for row in rows]
        n_known = sum(value is not None for value in values)
        if not n_known:
            columns = dict.fromkeys(key for row in rows for key, value in row.items() if _number(value) is not None)
            hint = did_you_mean(condition.column, columns, cutoff=0.7)
            unanswered.append(f"--flag {condition}: no row has a value for {condition.column!r}{hint}")
            reporter.error(unanswered[-1])
        elif n_known < len(rows):
            reporter.info(f"warning: --flag {condition}: {len(rows) - n_known} of {len(rows)} rows have no value")
        for k, value in enumerate(values):
            if value is not None and _COMPARISONS[condition.comparison](value, condition.limit):
                reasons[k].append(f"{condition.column} {value:.4g} {condition.comparison} {condition.limit:g}")
                distances[k].append(abs(value - condition.limit))
    worst = sorted((k for k in range(len(rows)) if reasons[k]), key=lambda k: (-len(reasons[k]), -distances[k][0]))
    flagged = tuple(Flagged(str(rows[k]["scene"]), str(rows[k].get("run", "")), tuple(reasons[k])) for k in worst)
    return Flags(tuple(map(str, conditions)), flagged, len(rows), tuple(unanswered))


def plain_name(heading: str) -> str:
    """Return a heading with single spaces and short numbers: ``bad 1.0`` becomes ``bad 1``."""
    return " ".join(f"{float(word):g}" if _NUMBER.fullmatch(word) else word for word in heading.split())


def _number(value: Any) -> float | None:
    """Return a finite number, or the sum of a mapping's values (seconds by stage), or None for other values."""
    if isinstance(value, Mapping):
        return math.fsum(value.values()) if value else None
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return None
    return float(value)
