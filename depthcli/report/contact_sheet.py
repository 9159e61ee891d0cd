"""One picture of an evaluation: a row for each scene, image above truth, and every run's map above its errors."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.evaluation.comparison import EvaluationReport
from depthcli.evaluation.protocols import AnyProtocol, picture
from depthcli.evaluation.scores import MapResult
from depthcli.io.formats.images import write_png
from depthcli.io.formats.pictures import draw_text
from depthcli.io.scenes import Scene
from depthcli.report.colors import map_picture

Picture: TypeAlias = NDArray[np.uint8]

_MAX_SCENES = 4  # rows: the sheet fits a screen
_MAX_RUNS = 4
_WIDTH, _GAP, _LINE = 240, 8, 20  # pixels: width of one picture, space around it, height of a line of text
_INK = (40, 40, 40)


class ContactSheet:
    """Small pictures of the first scenes of an evaluation, side by side; a ``Viewer``."""

    file = "contact_sheet.png"

    def __init__(self) -> None:
        self._ends = 0.0, 1.0
        self._rows: dict[str, dict[str, list[Picture]]] = {}
        self._scene = ""

    def begin(self, folder: Path) -> None:
        """Begin a sheet in ``folder``."""
        self._path = folder / self.file

    def begin_scene(self, protocol: AnyProtocol, scene: Scene, truth: Any) -> None:
        """Begin the row of a scene; one without an image, or a volume, has no row, nor has any after the first ones."""
        self._scene = ""
        if not protocol.presentation.error_pictures or len(self._rows) >= _MAX_SCENES:
            return
        image, values = protocol.presentation.image(scene), truth.values
        if image is None or image.ndim != 3 or image.shape[2] != 3:
            return
        self._scene = scene.name
        self._protocol = protocol
        row = self._rows[scene.name] = {"": [_small(image)]}
        if values.ndim == 2 and np.isfinite(values).any():
            known = values[np.isfinite(values)]
            self._ends = float(known.min()), float(known.max())
            row[""].append(_small(map_picture(values, *self._ends)))

    def add_map(self, result: MapResult, path: Path, estimate: Any, truth: Any, confidences: Mapping[str, Any]) -> None:
        """Add one run's map and its error picture."""
        if result.scene != self._scene:
            return
        row, protocol = self._rows[self._scene], self._protocol
        maps = [protocol.values(estimate, truth)] if len(row[""]) > 1 else []
        errors = picture(protocol, estimate, truth)
        row[result.run] = [_small(map_picture(values, *self._ends)) for values in maps]
        row[result.run] += [] if errors is None else [_small(errors)]

    def write(self, report: EvaluationReport, scores: str, configs: Mapping[str, str]) -> None:
        """Write the sheet as PNG, if there is something to show."""
        runs = report.runs[:_MAX_RUNS]
        rows = {scene: row for scene, row in self._rows.items() if any(run in row for run in runs)}
        if not rows:
            return
        columns = ["", *(run for run in runs if any(run in row for row in rows.values()))]
        heights = [max(sum(len(each) + _GAP for each in row.get(run, ())) for run in columns) for row in rows.values()]
        width = _GAP + len(columns) * (_WIDTH + _GAP)
        sheet = np.full((_LINE + sum(_LINE + height for height in heights), width, 3), 255, np.uint8)
        for k, run in enumerate(columns):
            draw_text(sheet, run, (_GAP + k * (_WIDTH + _GAP), _LINE // 2), _INK, max_width=_WIDTH)
        top = _LINE
        for (scene, row), height in zip(rows.items(), heights, strict=True):
            draw_text(sheet, scene, (_GAP, top + _LINE // 2), _INK, max_width=_WIDTH)
            for k, run in enumerate(columns):
                y, x = top + _LINE, _GAP + k * (_WIDTH + _GAP)
                for small in row.get(run, ()):
                    sheet[y : y + len(small), x : x + _WIDTH] = small
                    y += len(small) + _GAP
            top += _LINE + height
        write_png(self._path, sheet)


def _small(image: Picture) -> Picture:
    height = max(1, round(image.shape[0] * _WIDTH / image.shape[1]))
    shrink = cv2.INTER_AREA if image.shape[1] > _WIDTH else cv2.INTER_NEAREST
    return np.asarray(cv2.resize(image, (_WIDTH, min(height, 2 * _WIDTH)), interpolation=shrink), np.uint8)
