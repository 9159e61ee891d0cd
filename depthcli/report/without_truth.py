"""Scenes without ground truth on the page: with the run's own figures, the worst scene first."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from depthcli.core.errors import InputError
from depthcli.evaluation.protocols import AnyProtocol
from depthcli.io.formats.files import collected_warnings
from depthcli.io.scenes import Scene
from depthcli.report.scene_view import SceneView, scale_of
from depthcli.show.table import SECONDS, Column, Number, Row, Table
from depthcli.show.view import Palette, View

_MAX_SHOWN = 300  # scenes without truth with pictures; more would make the page slow
_DOUBTS = {"expected_right": -1, "inside_mean": 1, "mean_error": 1, "measured": -1, "density": -1}
"""Columns of reports by which the scenes with pictures are chosen where there are too many; 1: larger is worse."""


class RunWithoutTruth(NamedTuple):
    """Scenes of a run without ground truth, with the run's own figures."""

    name: str
    folder: Path
    protocol: AnyProtocol  # gives the places of maps and how they are shown; it scores nothing here
    palette: Palette | None  # colors and words of the status maps; None: the protocol's
    scenes: Sequence[Scene]
    rows: Mapping[str, Row]  # scene -> its row of the run's report
    columns: Sequence[Column]  # further columns of the table, made from the rows
    warnings: Sequence[str]  # of the rows, one line a kind
    lower_bounds: frozenset[str]  # scenes whose figures are lower bounds, shown as ``> 14``


@dataclass(frozen=True)
class ScenesWithoutTruth:
    """A run's scenes on the page: a table, and the views of scenes with pictures, in its order."""

    run: RunWithoutTruth
    table: Table  # a row a scene; its note explains the figures
    by: str  # heading of the figure by which the scenes are ordered; or empty
    n_failed: int  # scenes that failed, which come first and have the reason in their second cell
    n_left_out: int  # scenes without pictures, which come last
    views: list[SceneView]


def scenes_without_truth(run: RunWithoutTruth, save: Callable[[SceneView], None]) -> ScenesWithoutTruth:
    """Return the scenes of a run, the worst first; ``save`` gets every view as soon as it is complete."""
    rows = {scene.name: run.rows.get(scene.name, {}) for scene in run.scenes}
    reasons = {name: str(row.get("error") or "failed") for name, row in rows.items() if row.get("status") == "failed"}
    done = [scene for scene in run.scenes if scene.name not in reasons]
    done.sort(key=lambda scene: _doubt(rows[scene.name]))
    views: dict[str, SceneView] = {}
    for scene in done[:_MAX_SHOWN]:
        try:
            views[scene.name] = _view(run, scene)
        except InputError as error:
            reasons[scene.name] = str(error)
        else:
            save(views[scene.name])
    keys = list(dict.fromkeys(key for view in views.values() for key in view.figures | view.mean_confidence))
    worst = {name: [math.inf if math.isnan(v) else -v for v in view.figures.values()] for name, view in views.items()}
    ordered, left_out = sorted(views, key=lambda name: (worst[name], name)), [scene.name for scene in done[_MAX_SHOWN:]]
    names = [*sorted(reasons), *ordered, *left_out]
    columns = [
        Column("scene", str),
        Column("status", lambda name: reasons.get(name) or str(rows[name].get("status") or "done")),
    ]
    for key in keys:
        columns.append(Column(key, {name: _figure(views.get(name), key) for name in names}.__getitem__))
    for column in (*run.columns, SECONDS):
        cells = {name: "-" if name in reasons or not row else column.cell(row) for name, row in rows.items()}
        columns.append(Column(column.heading, cells.__getitem__))
    columns = [column for column in columns if any(column.cell(name) != "-" for name in names)]
    note = "; ".join(dict.fromkeys(view.note for view in views.values() if view.note))
    table, by = Table("", columns, names, note), keys[0] if keys else ""
    return ScenesWithoutTruth(run, table, by, len(reasons), len(left_out), [views[name] for name in ordered])


def _figure(view: SceneView | None, key: str) -> str:
    """Return a figure of a view, or the mean of a confidence; ``-`` if there is none."""
    if view is None:
        return "-"
    figures = view.figures | view.mean_confidence
    return (view.above if key in view.figures else "") + Number(figures.get(key, math.nan))


def _view(run: RunWithoutTruth, scene: Scene) -> SceneView:
    """Return the view of a scene without truth. Raise InputError where its map cannot be read."""
    protocol, presentation = run.protocol, run.protocol.presentation
    path = protocol.files.find(run.folder, [scene.name])
    if path is None:
        raise InputError("no map there")
    with collected_warnings():
        shown = presentation.show(path, scene, protocol.files)
        base = View(shown.values, presentation.unit, presentation.scale or scale_of(shown.values), axes=shown.axes)
        view = SceneView(scene, protocol, base, run.palette)
        view.add_shown(run.name, path, shown)
        view.above = "> " * (scene.name in run.lower_bounds)
    return view


def _doubt(row: Row) -> tuple[float, ...]:
    """Return a key of a row of the report: the worse its scene is, the smaller."""
    values = ((row.get(key), sign) for key, sign in _DOUBTS.items())
    return tuple(-sign * value if isinstance(value, int | float) else math.inf for value, sign in values)
