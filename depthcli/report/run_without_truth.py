"""The scenes of a run that have no ground truth: their maps, and the table of what the run says of itself."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from depthcli.core.errors import InputError
from depthcli.evaluation.protocols import AnyProtocol
from depthcli.evaluation.render import Number
from depthcli.io.formats.files import collected_warnings
from depthcli.io.formats.pictures import Palette
from depthcli.io.scenes import Scene
from depthcli.report.scene_view import SceneView, view_of_run
from depthcli.run.console import Column
from depthcli.run.json_csv import Row

_MAX_SHOWN = 300  # scenes with pictures; more would make the page slow
_DOUBTS = {"inside_mean": 1, "mean_error": 1, "measured": -1, "density": -1}
"""Columns of reports by which the scenes with pictures are chosen where there are too many; 1: larger is worse."""


@dataclass(frozen=True)
class RunTable:
    """What the template shows of scenes without truth, the worst first.

    Attributes
    ----------
    run : name of the run
    header : headings of the columns
    rows : (scene, cells); a failed scene has the reason in its second cell
    note : explanation of the figures
    by : heading of the figure that orders the scenes; empty: there is none
    n_failed, n_left_out : number of failed scenes, and of those without pictures
    views : scenes with pictures
    """

    run: str
    header: list[str]
    rows: list[tuple[str, list[str]]]
    note: str
    by: str
    n_failed: int
    n_left_out: int
    views: list[SceneView]


@dataclass
class RunWithoutTruth:
    """Scenes of a run without truth.

    Attributes
    ----------
    name, folder : of the run
    protocol : says where maps lie and how they are shown; it scores nothing here
    palette : colors and words of the status maps; None: the protocol's
    scenes : the scenes without truth
    rows : scene -> its row of the run's report
    columns : further columns of the table, made from the rows
    """

    name: str
    folder: Path
    protocol: AnyProtocol
    palette: Palette | None
    scenes: Sequence[Scene]
    rows: Mapping[str, Row]
    columns: Sequence[Column]
    _views: dict[str, SceneView] = field(default_factory=dict)
    _problems: dict[str, str] = field(default_factory=dict)

    def views(self) -> Iterator[SceneView]:
        """Yield the view of every scene whose map can be read; of very many scenes, of the worst by the report."""
        done = [scene for scene in self.scenes if self.rows.get(scene.name, {}).get("status") != "failed"]
        for scene in sorted(done, key=lambda scene: _doubt(self.rows.get(scene.name, {})))[:_MAX_SHOWN]:
            try:
                path = self.protocol.files.find(self.folder, [scene.name])
                if path is None:
                    raise InputError(f"no map there{self.protocol.files.searched([scene.name])}")
                with collected_warnings():
                    view = view_of_run(self.protocol, scene, self.name, path, self.palette)
            except InputError as error:
                self._problems[scene.name] = str(error)
                continue
            self._views[scene.name] = view
            yield view

    def _rank(self, name: str) -> tuple[float, ...]:
        """Return the key by which scenes are ordered: failed ones first, then by the figures, the largest first."""
        if name not in self._views:
            failed = self.rows.get(name, {}).get("status") == "failed" or name in self._problems
            return (-2.0,) if failed else (0.0, *_doubt(self.rows.get(name, {})))
        figures = self._views[name].figures.values()
        return (-1.0, *(math.inf if math.isnan(value) else -value for value in figures))

    def table(self) -> RunTable:
        """Return the table of all scenes, after ``views`` made the pictures."""
        shown = {name: view.figures | view.mean_confidence for name, view in self._views.items()}
        keys = list(dict.fromkeys(key for figures in shown.values() for key in figures))
        names = sorted((scene.name for scene in self.scenes), key=lambda name: (self._rank(name), name))
        rows = []
        for name in names:
            row, figures = self.rows.get(name, {}), shown.get(name, {})
            reason = str(row.get("error") or self._problems.get(name, ""))
            cells = [reason or str(row.get("status") or "done")]
            cells += [str(Number(figures[key])) if key in figures else "-" for key in keys]
            cells += [column.text(row) if row and not reason else "-" for column in self.columns]
            seconds = math.fsum(row.get("seconds", {}).values())
            rows.append((name, [*cells, f"{seconds:.2f}" if seconds else "-"]))
        n_failed = sum(self._rank(name) == (-2.0,) for name in names)
        header = ["status", *keys, *(column.title for column in self.columns), "seconds"]
        filled = [k for k in range(len(header)) if any(cells[k] != "-" for _, cells in rows)]
        return RunTable(
            run=self.name,
            header=["scene", *(header[k] for k in filled)],
            rows=[(name, [cells[k] for k in filled]) for name, cells in rows],
            note="; ".join(dict.fromkeys(view.note for view in self._views.values() if view.note)),
            by=keys[0] if keys else "",
            n_failed=n_failed,
            n_left_out=len(names) - len(self._views) - n_failed,
            views=[self._views[name] for name in names if name in self._views],
        )


def _doubt(row: Row) -> tuple[float, ...]:
    """The worse a scene is by its row of the report, the smaller."""
    values = ((row.get(key), sign) for key, sign in _DOUBTS.items())
    return tuple(-sign * value if isinstance(value, int | float) else math.inf for value, sign in values)
