"""Rows of a report that conditions hold for: the scenes, and the regions of them, that a person should look at."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from depthcli.core.conditions import MIN_SCORED, Condition, plain_name
from depthcli.core.region_columns import ERROR, FIGURES, region_column


@dataclass(frozen=True)
class Flagged:
    """A row that conditions hold for.

    Attributes
    ----------
    scene, run : what the row is of; no run where there is one alone
    reasons : the conditions that hold, with the row's values
    region : the region of the scene that the conditions are on; empty: the whole scene
    """

    scene: str
    run: str
    reasons: tuple[str, ...]
    region: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Return plain values, for JSON."""
        optional = {"run": self.run, "region": self.region}
        return {"scene": self.scene, **{k: v for k, v in optional.items() if v}, "reasons": list(self.reasons)}


@dataclass(frozen=True)
class Verdict:
    """What the conditions on regions say of one region of one scene.

    Attributes
    ----------
    scene, run, region : what it is of; no run where there is one alone
    verdict : flagged; passed; or unknown, where no condition found a value
    value : what the first condition that holds compared, else the first one with a value; None: no value
    reasons : the conditions that hold, with the row's values
    """

    scene: str
    run: str
    region: str
    verdict: str
    value: float | None
    reasons: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return plain values, for JSON."""
        run = {"run": self.run} if self.run else {}
        said = {"verdict": self.verdict, "value": self.value, "reasons": list(self.reasons)}
        return {"scene": self.scene, **run, "region": self.region, **said}


@dataclass(frozen=True)
class Flags:
    """What conditions say of all rows.

    Attributes
    ----------
    flagged : the rows that a condition holds for, worst first
    verdicts : one for every scene and region, where a condition is on regions
    n_rows : number of rows
    conditions : as they were given; none: nobody asked
    warnings : of conditions that some rows have no value for
    unanswered : of conditions that no row has a value for; a z-score of too few values is a warning
    """

    flagged: tuple[Flagged, ...] = ()
    verdicts: tuple[Verdict, ...] = ()
    n_rows: int = 0
    conditions: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    unanswered: tuple[str, ...] = ()

    @property
    def regions(self) -> list[str]:
        """Names of the regions with verdicts: first those flagged in some scene, then those with a value."""
        ranks: dict[str, int] = {}
        for each in self.verdicts:
            ranks[each.region] = min(ranks.get(each.region, 2), ("flagged", "passed", "unknown").index(each.verdict))
        return sorted(ranks, key=ranks.__getitem__)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values, for JSON: nothing without conditions, and no ``verdicts`` without one on regions."""
        if not self.conditions:
            return {}
        verdicts = {"verdicts": [each.to_dict() for each in self.verdicts]} if self.verdicts else {}
        return {"flagged": [each.to_dict() for each in self.flagged], **verdicts}


def flag_rows(conditions: Sequence[Condition], rows: Sequence[Mapping[str, Any]]) -> Flags:
    """Return which rows the conditions flag, worst first.

    Those with the most reasons come first; among as many, those that are farthest beyond the limit of the first
    condition that holds for them. A condition on a figure of regions, such as ``region_95>5``, is asked of every region
    of every scene; a mask that cannot be used is flagged whatever regions they name, as nobody knows what it holds.

    Parameters
    ----------
    rows : column -> value; each has a ``scene``, and may have a ``run``
    """
    placed = list(enumerate(conditions))
    on_scenes = [(place, each) for place, each in placed if each.of_region is None]
    on_regions = [(place, each) for place, each in placed if each.of_region is not None]
    of_scenes = _evaluated(on_scenes, rows)
    of_regions = _evaluated(
        on_regions,
        [row for row in _rows_of_regions(rows) if row["error"] or any(_concerns(each, row) for _, each in on_regions)],
    )
    worst_first = sorted([*of_scenes.flagged, *of_regions.flagged], key=lambda each: each[0])
    lines = [*of_scenes.lines, *of_regions.lines]
    return Flags(
        flagged=tuple(each for _, each in worst_first),
        verdicts=tuple(of_regions.verdicts),
        n_rows=len(rows),
        conditions=tuple(condition.text for condition in conditions),
        warnings=tuple(line.text for line in lines if line.is_answered),
        unanswered=tuple(line.text for line in lines if not line.is_answered),
    )


class _Line(NamedTuple):
    """What is said of a condition that lacks values; it is answered where some row has one, or too few for z()."""

    text: str
    is_answered: bool


class _Evaluated(NamedTuple):
    """Flagged rows, each with what sorts it; a verdict for every row; and what is said of the conditions."""

    flagged: list[tuple[tuple[float, ...], Flagged]]
    verdicts: list[Verdict]
    lines: list[_Line]


def _evaluated(conditions: Sequence[tuple[int, Condition]], rows: Sequence[Mapping[str, Any]]) -> _Evaluated:
    """Return what conditions, each with its place among all, say of rows."""
    reasons: list[list[str]] = [[] for _ in rows]
    beyond: list[list[tuple[int, float]]] = [[] for _ in rows]  # the condition's place, minus the distance
    flagging: list[list[Any]] = [[] for _ in rows]  # values that a condition holds for
    passing: list[list[Any]] = [[] for _ in rows]
    found = _Evaluated([], [], [])
    for place, condition in conditions:
        concerned = [k for k, row in enumerate(rows) if _concerns(condition, row)]
        values = condition.values([rows[k] for k in concerned])
        found.lines.extend(_lines(condition, [rows[k] for k in concerned], values))
        for k, value in zip(concerned, values, strict=True):
            if condition.holds_for(value):
                flagging[k].append(value)
                reasons[k].append(condition.reason(value))
                beyond[k].append((place, -condition.distance(value)))
            elif value is not None:
                passing[k].append(value)
    for k, row in enumerate(rows):
        scene, run, region = str(row["scene"]), str(row.get("run", "")), str(row.get("region", ""))
        if error := row.get("error") if region else None:
            reasons[k], beyond[k] = [str(error)], [(-1, 0.0)]
        if reasons[k]:
            rank = (-len(reasons[k]), *beyond[k][0], float(k))
            found.flagged.append((rank, Flagged(scene, run, tuple(reasons[k]), region)))
        known = [*flagging[k], *passing[k]]
        verdict = "flagged" if reasons[k] else "passed" if known else "unknown"
        found.verdicts.append(Verdict(scene, run, region, verdict, known[0] if known else None, tuple(reasons[k])))
    return found


def _lines(condition: Condition, rows: Sequence[Mapping[str, Any]], values: Sequence[Any]) -> list[_Line]:
    """Return the line that says that a condition found no values, or not all of them; none where it found all."""
    n_known, what = sum(value is not None for value in values), "row" if condition.of_region is None else "region"
    start = f"condition {condition.text!r}"
    if not rows and condition.of_region is not None:
        return [_Line(f"{start} flags nothing: there is no such region", False)]
    if not n_known:
        unscored = condition.robust and any(v is not None for v in replace(condition, robust=False).values(rows))
        why = f"fewer than {MIN_SCORED} values" if unscored else f"no {what} has a value there"
        near = "" if unscored or condition.of_region else _like(condition.column, rows)
        return [_Line(f"{start} flags nothing: {why}{near}", unscored)]
    if n_known < len(rows):
        return [_Line(f"{start}: {len(rows) - n_known} of {len(rows)} {what}s have no value there", True)]
    return []


def _concerns(condition: Condition, row: Mapping[str, Any]) -> bool:
    """Return whether a row is of the region that a condition names, or the condition names none."""
    return condition.of_region is None or plain_name(condition.of_region[1]) in ("", plain_name(row["region"]))


def _like(heading: str, rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the words that name a heading with values that is like one without; empty where there is none."""
    known = dict.fromkeys(key for row in rows for key, value in row.items() if isinstance(value, int | float))
    near = difflib.get_close_matches(heading, known, 1, 0.7)
    return f"; there is {near[0]!r}" if near else ""


def _rows_of_regions(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return a row for every scene and region, of all regions of the same run, so that none is missed."""
    starts = [region_column(name) for name in (*FIGURES, ERROR)]
    regions: dict[Any, dict[str, None]] = {}
    for row in rows:
        names = (key.removeprefix(start) for key in row for start in starts if key.startswith(start))
        regions.setdefault(row.get("run"), {}).update(dict.fromkeys(names))
    made = []
    for row in rows:
        for region in regions[row.get("run")]:
            of_region = {"scene": row["scene"], "region": region, "error": row.get(region_column(ERROR, region))}
            of_region |= {"run": row["run"]} if "run" in row else {}
            made.append(of_region | {figure: row.get(region_column(figure, region)) for figure in FIGURES})
    return made
