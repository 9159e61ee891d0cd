"""One picture of an evaluation: a row per scene with image, ground truth, sensor, and maps and errors of all runs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.evaluation.comparison import EvaluationReport
from depthcli.evaluation.evaluate import ScoredMap, Viewer
from depthcli.evaluation.protocols import AnyProtocol, picture
from depthcli.evaluation.scores import MapResult, difference
from depthcli.io.formats.images import write_png
from depthcli.io.scenes import Scene
from depthcli.show.view import NO_VALUE, Picture, View, draw, draw_swatch, draw_text, kind_colors

_MAX_SCENES = 4  # rows: the sheet fits a screen
_MAX_RUNS = 4
_WIDTH, _GAP, _LINE = 240, 8, 20  # pixels: width of one picture, space around it, height of a line of text
_INK = (40, 40, 40)


class _Row(NamedTuple):
    """A scene of the sheet."""

    scene: str
    protocol: AnyProtocol
    pictures: dict[str, list[Picture]]  # run -> those below each other; empty: of the scene itself
    results: list[MapResult]


class ContactSheet(Viewer):
    """Small pictures of the scenes of an evaluation whose maps differ most, side by side."""

    file = "contact_sheet.png"

    def __init__(self) -> None:
        self._ends = 0.0, 1.0
        self._rows: list[_Row] = []  # of those that differ most, the scene under way last
        self._scene = ""
        self._runs: set[str] = set()  # that have a map

    def begin_scene(self, protocol: AnyProtocol, scene: Scene, truth: Any) -> None:
        """Begin the row of a scene; one without an image, or a volume, has no row."""
        self._choose()
        self._scene = ""
        presentation = protocol.presentation
        if not presentation.error_pictures:
            return
        image, values = presentation.image(scene), truth.values
        if image is None or image.ndim != 3 or image.shape[2] != 3:
            return
        self._scene = scene.name
        pictures = [_named("image", image)]
        if values.ndim == 2 and np.isfinite(values).any():
            known = values[np.isfinite(values)]
            self._ends = float(known.min()), float(known.max())
            sensor = presentation.sensor(scene)
            pictures.append(self._map("ground truth", values))
            if sensor is not None and sensor.shape == values.shape:
                pictures.append(self._map("sensor", sensor))
            pictures.append(_bar(*self._ends, presentation.unit))
        self._rows.append(_Row(scene.name, protocol, {"": pictures}, []))

    def add_map(self, scored: ScoredMap) -> None:
        result, _, estimate, truth, *_ = scored
        if result.scene != self._scene:
            return
        row = self._rows[-1]
        row.results.append(result)
        self._runs.add(result.run)
        pictures = row.pictures[result.run] = []
        if len(row.pictures[""]) > 1:
            pictures.append(self._map("map", row.protocol.values(estimate, truth)))
        if (errors := picture(row.protocol, estimate, truth)) is not None:
            pictures.append(_named("errors", errors))

    def _map(self, name: str, values: NDArray[np.floating[Any]]) -> Picture:
        return _named(name, draw(View(values, scale=self._ends), "values"))

    def _choose(self) -> None:
        """Keep the scenes that differ most so far, in this order."""
        several = len(self._runs) > 1
        self._rows.sort(key=lambda row: -difference(row.results, row.protocol.headline, several))
        del self._rows[_MAX_SCENES:]

    def write(self, report: EvaluationReport, scores: str, configs: Mapping[str, str]) -> None:
        """Write the sheet as PNG if there are scenes to show."""
        self._choose()
        runs = report.runs[:_MAX_RUNS]
        rows = [row for row in self._rows if row.pictures.keys() & runs]
        if not rows:
            return
        present = set[str]().union(*(row.pictures for row in rows))
        columns = [run for run in ("", *runs) if run in present]
        heights = [
            max(sum(len(picture) + _GAP for picture in row.pictures.get(run, ())) for run in columns) for row in rows
        ]
        width = _GAP + len(columns) * (_WIDTH + _GAP)
        words = rows[0].protocol.presentation
        kinds = [(text, color) for text, color in zip(words.pixel_kind_names, kind_colors().tolist(), strict=True)
                 if words.visible_region or not text.endswith("occluded")]  # fmt: skip
        lines = 2 + len(kinds)
        sheet = np.full((sum(_LINE + height for height in heights) + lines * _LINE + _GAP, width, 3), 255, np.uint8)
        which = "where they differ most" if len(report.runs) > 1 else "the worst first"
        title = f"{len(rows)} of {report.n_scenes} scenes, {len(columns) - 1} of {len(report.runs)} runs: {which}"
        draw_text(sheet, title, (_GAP, _LINE // 2), _INK, max_width=width - 2 * _GAP)
        for k, run in enumerate(columns):
            draw_text(sheet, run, (_GAP + k * (_WIDTH + _GAP), _LINE + _LINE // 2), _INK, max_width=_WIDTH)
        top = 2 * _LINE
        for row, height in zip(rows, heights, strict=True):
            draw_text(sheet, row.scene, (_GAP, top + _LINE // 2), _INK, max_width=_WIDTH)
            for k, run in enumerate(columns):
                y, x = top + _LINE, _GAP + k * (_WIDTH + _GAP)
                for small in row.pictures.get(run, ()):
                    sheet[y : y + len(small), x : x + _WIDTH] = small
                    y += len(small) + _GAP
            top += _LINE + height
        for text, color in kinds:
            draw_swatch(sheet, text, (_GAP, top), color)
            top += _LINE
        write_png(self.folder / self.file, sheet)


def _bar(low: float, high: float, unit: str) -> Picture:
    """Return the scale of the maps' colors with its ends, and the color of no value."""
    bar = np.full((2 * _LINE, _WIDTH, 3), 255, np.uint8)
    bar[2:12] = draw(View(np.linspace(low, high, _WIDTH)[None], scale=(low, high)), "values")
    draw_text(bar, f"{low:.4g} to {high:.4g} {unit}", (0, _LINE), _INK)
    draw_swatch(bar, "no value", (_WIDTH - 100, _LINE // 2), NO_VALUE)
    return bar


def _named(name: str, image: Picture) -> Picture:
    """Return a small picture below its name."""
    height = max(1, round(image.shape[0] * _WIDTH / image.shape[1]))
    shrink = cv2.INTER_AREA if image.shape[1] > _WIDTH else cv2.INTER_NEAREST
    small = cv2.resize(image, (_WIDTH, min(height, 2 * _WIDTH)), interpolation=shrink)
    panel = np.full((_LINE + len(small), _WIDTH, 3), 255, np.uint8)
    panel[_LINE:] = small
    draw_text(panel, name, (0, _LINE // 2), _INK, max_width=_WIDTH)
    return panel
