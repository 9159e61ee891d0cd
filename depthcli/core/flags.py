"""Rows of a report that conditions hold for: the scenes, and the regions of them, that a person should look at."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from depthcli.core.conditions import MIN_SCORED, Condition

REGION_ERROR = "region_error_"
"""Beginning of the columns that say why a region could not be measured; its name follows."""

_FIGURES = ("region_mean", "region_95", "region_volume")


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
    of every scene.

    Parameters
    ----------
    rows : column -> value; each has a ``scene``, and may have a ``run``
    """
    by_region = _by_region(rows)
    of_scenes = [(place, each) for place, each in enumerate(conditions) if each.of_region is None]
    of_regions = [(place, each) for place, each in enumerate(conditions) if each.of_region is not None]
    asked = [row for row in by_region if any(_concerns(condition, row) for _, condition in of_regions)]
    found, _, warnings = _asked(of_scenes, rows)
    in_regions, verdicts, more = _asked(of_regions, asked)
    worst_first = sorted([*found, *in_regions], key=lambda each: each[0])
    lines = [*warnings, *more]
    return Flags(
        flagged=tuple(each for _, each in worst_first),
        verdicts=tuple(verdicts),
        n_rows=len(rows),
        conditions=tuple(condition.text for condition in conditions),
        warnings=tuple(line for line, answered in lines if answered),
        unanswered=tuple(line for line, answered in lines if not answered),
    )


def _asked(
    conditions: Sequence[tuple[int, Condition]], rows: Sequence[Mapping[str, Any]]
) -> tuple[list[tuple[tuple[float, ...], Flagged]], list[Verdict], list[tuple[str, bool]]]:
    """Flagged rows, each with what sorts it; a verdict for every row; and lines, each with whether it is a warning.

    Conditions come with their places among all, by which the first one counts most.
    """
    reasons: list[list[str]] = [[] for _ in rows]
    beyond: list[list[tuple[int, float]]] = [[] for _ in rows]  # the condition's place, minus the distance
    known: list[list[Any]] = [[] for _ in rows]  # those that conditions hold for come first
    warnings: list[tuple[str, bool]] = []
    for place, condition in conditions:
        concerned = [k for k, row in enumerate(rows) if _concerns(condition, row)]
        values = condition.values([rows[k] for k in concerned])
        warnings += _warnings(condition, [rows[k] for k in concerned], values)
        for k, value in zip(concerned, values, strict=True):
            if value is not None:
                known[k].insert(len(reasons[k]) if condition.holds_for(value) else len(known[k]), value)
            if condition.holds_for(value):
                reasons[k].append(condition.reason(value))
                beyond[k].append((place, -condition.distance(value)))
    flagged: list[tuple[tuple[float, ...], Flagged]] = []
    verdicts = []
    for k, row in enumerate(rows):
        scene, run, region = str(row["scene"]), str(row.get("run", "")), str(row.get("region", ""))
        if error := row.get("error") if region else None:
            reasons[k], beyond[k] = [str(error)], [(-1, 0.0)]
        if reasons[k]:
            rank = (-len(reasons[k]), *beyond[k][0], float(k))
            flagged.append((rank, Flagged(scene, run, tuple(reasons[k]), region)))
        verdict = "flagged" if reasons[k] else "passed" if known[k] else "unknown"
        verdicts.append(Verdict(scene, run, region, verdict, known[k][0] if known[k] else None, tuple(reasons[k])))
    return flagged, verdicts, warnings


def _warnings(condition: Condition, rows: Sequence[Mapping[str, Any]], values: Sequence[Any]) -> list[tuple[str, bool]]:
    """The line that says that a condition found no values, or not all of them, and whether it is answered at all."""
    n_known, what = sum(value is not None for value in values), "row" if condition.of_region is None else "region"
    start = f"condition {condition.text!r}"
    if not rows and condition.of_region is not None:
        return [(f"{start} flags nothing: there is no such region", False)]
    if not n_known:
        few = condition.robust and any(value is not None for value in replace(condition, robust=False).values(rows))
        why = f"fewer than {MIN_SCORED} values" if few else f"no {what} has a value there"
        return [(f"{start} flags nothing: {why}", few)]
    if n_known < len(rows):
        return [(f"{start}: {len(rows) - n_known} of {len(rows)} {what}s have no value there", True)]
    return []


def _concerns(condition: Condition, row: Mapping[str, Any]) -> bool:
    """Whether a row is of the region that a condition names, or the condition names none."""
    return condition.of_region is None or condition.of_region[1] in ("", row["region"])


def _by_region(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """A row for every scene and region: of all regions that a scene of the same run has, so that none is missed."""
    starts = (*(f"{figure}_" for figure in _FIGURES), REGION_ERROR)
    regions: dict[Any, dict[str, None]] = {}
    for row in rows:
        names = (key.removeprefix(start) for key in row for start in starts if key.startswith(start))
        regions.setdefault(row.get("run"), {}).update(dict.fromkeys(names))
    made = []
    for row in rows:
        for region in regions[row.get("run")]:
            of_region = {"scene": row["scene"], "region": region, "error": row.get(f"{REGION_ERROR}{region}")}
            of_region |= {"run": row["run"]} if "run" in row else {}
            made.append(of_region | {figure: row.get(f"{figure}_{region}") for figure in _FIGURES})
    return made
