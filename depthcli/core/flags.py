"""Conditions on the columns of a report that flag rows: which scenes a person should look at."""

from __future__ import annotations

import difflib
import math
import operator
import re
import statistics
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from depthcli.core.columns import ColumnHelp, find_column
from depthcli.core.errors import ConfigError

MIN_SCORED = 5
"""Number of values below which no robust z-score is computed."""

_OPERATORS: dict[str, Callable[[Any, Any], bool]] = {
    "<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge, "=": operator.eq, "!=": operator.ne,
}  # fmt: skip
_CONDITION = re.compile(
    r"\s*(?:z\((?P<robust>[^()]+)\)|(?P<plain>[^<>=!]+?))\s*(?P<op><=|>=|!=|==|=|<|>)\s*(?P<value>\S+)\s*"
)
_PLAIN_NUMBER = re.compile(r"\d+\.?\d*|\.\d+")
_MAD_SCALE, _MEAN_SCALE = 1.4826, 1.2533  # of a normal distribution: sigma / median, and / mean absolute deviation


@dataclass(frozen=True)
class Condition:
    """A column compared with a value, such as ``measured<0.6``, ``z(measured)<-3.5`` or ``status=failed``.

    Attributes
    ----------
    text : as it was given
    column : heading of the column, without z()
    robust : the column's robust z-scores among the rows of the same run are compared, not its values
    op : the comparison
    value : a number, or a word after ``=`` and ``!=``
    also : other names of the column
    """

    text: str
    column: str
    robust: bool
    op: str
    value: float | str
    also: tuple[str, ...] = ()

    @classmethod
    def of(cls, text: str) -> Condition:
        """Return the condition that a text means; ConfigError where it means none."""
        found = _CONDITION.fullmatch(text)
        if found is None:
            raise ConfigError(f"flag: want COLUMN<NUMBER, or > <= >= = !=, or z(COLUMN)>NUMBER (got {text!r})")
        op, value = found["op"].replace("==", "="), found["value"]
        column, robust = plain_name(found["robust"] or found["plain"]), found["robust"] is not None
        try:
            number = float(value)
        except ValueError:
            if op not in ("=", "!=") or robust:
                raise ConfigError(f"condition {text!r}: want a number behind {op} (got {value!r})") from None
            return cls(text, column, robust, op, value)
        if not math.isfinite(number):
            raise ConfigError(f"condition {text!r}: want a finite number (got {value!r})")
        return cls(text, column, robust, op, number)

    def values(self, rows: Sequence[Mapping[str, Any]]) -> list[Any]:
        """Return what is compared, row by row; None where a row has no such value."""
        cells = [next((row[key] for key in (self.column, *self.also) if key in row), None) for row in rows]
        if isinstance(self.value, str):
            return [None if cell in (None, "") else str(cell) for cell in cells]
        numbers = [_number(cell) for cell in cells]
        if not self.robust:
            return numbers
        runs = [row.get("run") for row in rows]
        scores: list[float | None] = [None] * len(rows)
        for run in dict.fromkeys(runs):
            places = [k for k, each in enumerate(runs) if each == run]
            for k, score in zip(places, robust_scores([numbers[k] for k in places]), strict=True):
                scores[k] = score
        return scores

    def reason(self, value: Any) -> str:
        """Return the words for a row whose ``value`` meets the condition."""
        name = f"z({self.column})" if self.robust else self.column
        shown = value if isinstance(value, str) else f"{value:.4g}"
        limit = self.value if isinstance(self.value, str) else f"{self.value:g}"
        return f"{name} {shown}" if self.op == "=" else f"{name} {shown} {self.op} {limit}"


@dataclass(frozen=True)
class Flagged:
    """A row that conditions hold for.

    Attributes
    ----------
    scene, run : what the row is of; no run where there is one alone
    reasons : the conditions that hold, with the row's values
    """

    scene: str
    run: str
    reasons: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return plain values, for JSON."""
        return {"scene": self.scene, **({"run": self.run} if self.run else {}), "reasons": list(self.reasons)}


def parse_conditions(texts: Iterable[str], known: Iterable[ColumnHelp]) -> tuple[Condition, ...]:
    """Return the conditions that texts mean.

    Parameters
    ----------
    texts : one condition each
    known : all columns that there can be

    Raises
    ------
    ConfigError
        A text is no condition, or names a column that there is not.
    """
    known = tuple(known)
    conditions = []
    for condition in map(Condition.of, texts):
        words = condition.column.split()
        headings = (" ".join(words[:n]) for n in range(len(words), 0, -1))  # behind a metric may stand its region
        column = next(filter(None, (find_column(known, heading) for heading in headings)), None)
        if column is None:
            names = [name.strip() for column in known for name in column.name.split(",")]
            near = difflib.get_close_matches(condition.column, names, 1)
            meant = f"; did you mean {near[0]!r}?" if near else ""
            raise ConfigError(
                f"condition {condition.text!r}: no column {condition.column!r}{meant}; depthcli help columns has them"
            )
        conditions.append(replace(condition, also=() if column.pattern else (column.name, *column.also)))
    return tuple(conditions)


def plain_name(heading: str) -> str:
    """Return a heading with single spaces and the shortest form of its numbers: ``bad 1.0`` is ``bad 1``."""
    return " ".join(f"{float(word):g}" if _PLAIN_NUMBER.fullmatch(word) else word for word in heading.split())


def flag_rows(conditions: Sequence[Condition], rows: Sequence[Mapping[str, Any]]) -> tuple[list[Flagged], list[str]]:
    """Return the flagged rows, worst first, and warnings about conditions that say nothing here.

    Those with the most reasons come first; among as many, those that are farthest beyond the limit of the first
    condition that holds for them.

    Parameters
    ----------
    rows : column -> value; each has a ``scene``, and may have a ``run``
    """
    reasons: list[list[str]] = [[] for _ in rows]
    beyond: list[list[tuple[int, float]]] = [[] for _ in rows]  # the condition's place, minus the distance
    warnings = []
    for place, condition in enumerate(conditions):
        values = condition.values(rows)
        n_known = sum(value is not None for value in values)
        if not n_known:
            few = condition.robust and any(replace(condition, robust=False).values(rows))
            why = f"fewer than {MIN_SCORED} values" if few else "no row has a value there"
            warnings.append(f"condition {condition.text!r} flags nothing: {why}")
        elif n_known < len(rows):
            warnings.append(
                f"condition {condition.text!r}: {len(rows) - n_known} of {len(rows)} rows have no value there"
            )
        for k, value in enumerate(values):
            if value is not None and _OPERATORS[condition.op](value, condition.value):
                reasons[k].append(condition.reason(value))
                beyond[k].append((place, 0.0 if isinstance(value, str) else -abs(value - condition.value)))
    worst_first = sorted((k for k in range(len(rows)) if reasons[k]), key=lambda k: (-len(reasons[k]), beyond[k][0]))
    flagged = [Flagged(str(rows[k]["scene"]), str(rows[k].get("run", "")), tuple(reasons[k])) for k in worst_first]
    return flagged, warnings


def robust_scores(values: Sequence[float | None]) -> list[float | None]:
    """Return the robust z-scores of some values: their distances from the median in robust standard deviations.

    The standard deviation is 1.4826 times the median absolute deviation; where more than half of the values are alike,
    1.2533 times the mean absolute deviation (Iglewicz and Hoaglin, How to Detect and Handle Outliers, 1993).

    Returns
    -------
    None where there is no value, or fewer than ``MIN_SCORED`` in all
    """
    known = [value for value in values if value is not None]
    if len(known) < MIN_SCORED:
        return [None] * len(values)
    middle = statistics.median(known)
    deviations = [abs(value - middle) for value in known]
    sigma = _MAD_SCALE * statistics.median(deviations) or _MEAN_SCALE * math.fsum(deviations) / len(deviations)
    return [None if value is None else (value - middle) / sigma if sigma else 0.0 for value in values]


def _number(value: Any) -> float | None:
    """Return a finite number as such, the sum of seconds by stage, and None for everything else."""
    if isinstance(value, Mapping):
        return math.fsum(each for each in value.values() if isinstance(each, int | float)) if value else None
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return None
    return float(value)
