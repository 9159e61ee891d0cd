"""Conditions on the columns of a report, such as ``measured<0.6``: what they mean, and which values they compare."""

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
from depthcli.core.region_columns import figure_and_region

MIN_SCORED = 5
"""Number of values below which no robust z-score is computed."""

_OPERATORS: dict[str, Callable[[Any, Any], bool]] = {
    "<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge, "=": operator.eq, "!=": operator.ne,
}  # fmt: skip
_CONDITION = re.compile(
    r"\s*(?:z\((?P<robust>[^()]+)\)|(?P<plain>[^<>=!]+?))\s*(?P<op><=|>=|!=|==|=|<|>)\s*(?P<value>[^\s<>=!]\S*)\s*"
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
    robust : the column's robust z-scores among the rows of the same run and region are compared, not its values
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

    @property
    def of_region(self) -> tuple[str, str] | None:
        """The figure and the region that it is of, or empty for every region; None where it is of the whole scene."""
        return figure_and_region(self.column)

    def holds_for(self, value: Any) -> bool:
        """Return whether a value, as :meth:`values` returns them, meets the condition."""
        return value is not None and _OPERATORS[self.op](value, self.value)

    def distance(self, value: Any) -> float:
        """Return how far a value is from the limit; 0 between words."""
        return 0.0 if isinstance(value, str) else abs(value - self.value)

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
        names = (self.of_region[0],) if self.of_region else (self.column, *self.also)
        cells = [next((row[key] for key in names if key in row), None) for row in rows]
        if isinstance(self.value, str):
            return [None if cell in (None, "") else str(cell) for cell in cells]
        numbers = [_number(cell) for cell in cells]
        if not self.robust:
            return numbers
        groups = [(row.get("run"), row.get("region")) for row in rows]
        scores: list[float | None] = [None] * len(rows)
        for group in dict.fromkeys(groups):
            places = [k for k, each in enumerate(groups) if each == group]
            for k, score in zip(places, robust_scores([numbers[k] for k in places]), strict=True):
                scores[k] = score
        return scores

    def reason(self, value: Any) -> str:
        """Return the words for a row whose ``value`` meets the condition."""
        name = f"z({self.column})" if self.robust else self.column
        shown = value if isinstance(value, str) else f"{value:.4g}"
        limit = self.value if isinstance(self.value, str) else f"{self.value:g}"
        return f"{name} {shown}" if self.op == "=" else f"{name} {shown} {self.op} {limit}"


def parse_conditions(texts: Iterable[str], known: Iterable[ColumnHelp]) -> tuple[Condition, ...]:
    """Return the conditions that texts mean.

    Parameters
    ----------
    texts : one condition each
    known : all columns that there can be

    Raises
    ------
    ConfigError
        A text is no condition, names a column that there is not, or compares figures of regions with a word.
    """
    known = tuple(known)
    conditions = []
    for condition in map(Condition.of, texts):
        words = condition.column.split()
        headings = (" ".join(words[:n]) for n in range(len(words), 0, -1))  # behind a metric may stand its region
        column = next(filter(None, (find_column(known, heading) for heading in headings)), None)
        if column is None:
            near = _near(condition.column, known)
            meant = f"; did you mean {near!r}?" if near else ""
            raise ConfigError(
                f"condition {condition.text!r}: no column {condition.column!r}{meant}; depthcli help columns has them"
            )
        if condition.of_region is not None and isinstance(condition.value, str):
            raise ConfigError(f"condition {condition.text!r}: want a number (got {condition.value!r})")
        conditions.append(replace(condition, also=() if column.pattern else (column.name, *column.also)))
    return tuple(conditions)


def _near(name: str, known: Sequence[ColumnHelp]) -> str:
    """Return a heading that may be meant by a wrong one, with its numbers; empty where none is like it."""
    spaced = plain_name(re.sub(r"(?<=[A-Za-z])[ _-]?(?=[\d.]+$)", " ", name))
    if find_column(known, spaced) is not None:
        return spaced
    if find_column(known, spaced.lower()) is not None:
        return spaced.lower()
    numbers = iter(re.findall(r"(?<= )[\d.]+", spaced))
    headings = [heading for column in known for each in (column.name, *column.also) for heading in each.split(", ")]
    near = difflib.get_close_matches(re.sub(r"(?<= )[\d.]+", "T", spaced), headings, 1)
    return re.sub(r"\bT\b", lambda found: next(numbers, found[0]), near[0]) if near else ""


def plain_name(heading: str) -> str:
    """Return a heading with single spaces and the shortest form of its numbers: ``bad 1.0`` is ``bad 1``."""
    return " ".join(f"{float(word):g}" if _PLAIN_NUMBER.fullmatch(word) else word for word in heading.split())


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
