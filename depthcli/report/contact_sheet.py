"""One picture of an evaluation: a row for each scene, image above truth, and every run's map above its errors."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.io.formats.images import write_png
from depthcli.io.formats.pictures import draw_text
from depthcli.report.colors import map_picture

Picture: TypeAlias = NDArray[np.uint8]
Map: TypeAlias = NDArray[np.floating[Any]]

_MAX_SCENES = 4  # rows: the sheet fits a screen
_MAX_RUNS = 4
_WIDTH, _GAP, _LINE = 240, 8, 20  # pixels: width of one picture, space around it, height of a line of text
_INK = (40, 40, 40)


class ContactSheet:
    """Small pictures of the first scenes of an evaluation, side by side.

    Parameters
    ----------
    runs : names of the runs, a column each
    """

    def __init__(self, runs: Sequence[str]) -> None:
        self._runs = list(runs)[:_MAX_RUNS]
        self._ends = 0.0, 1.0
        self._rows: dict[str, dict[str, list[Picture]]] = {}

    @property
    def is_full(self) -> bool:
        """True once no further scene has a row: its image need not be read."""
        return len(self._rows) >= _MAX_SCENES

    def begin_scene(self, scene: str, image: NDArray[np.uint8] | None, truth: Map | None) -> None:
        """Begin the row of a scene; one without an image, or a volume, has no row.

        Parameters
        ----------
        scene : its name
        image : (H, W, 3), or None
        truth : (H, W), NaN = unknown, whose range is that of the colors of all maps; or None
        """
        if image is None or image.ndim != 3 or image.shape[2] != 3 or self.is_full:
            return
        row = self._rows[scene] = {"": [_small(image)]}
        if truth is not None and truth.ndim == 2 and np.isfinite(truth).any():
            known = truth[np.isfinite(truth)]
            self._ends = float(known.min()), float(known.max())
            row[""].append(_small(map_picture(truth, *self._ends)))

    def add_map(self, scene: str, run: str, values: Map | None, errors: NDArray[np.uint8]) -> None:
        """Add a run's (H, W) map, NaN = no value, and its (H, W, 3) error picture."""
        if scene not in self._rows or run not in self._runs:
            return
        has_map = values is not None and len(self._rows[scene][""]) > 1
        self._rows[scene][run] = [_small(map_picture(values, *self._ends))] if has_map and values is not None else []
        self._rows[scene][run].append(_small(errors))

    def write(self, path: Path) -> bool:
        """Write the sheet as PNG; False where there is nothing to show."""
        rows = {scene: row for scene, row in self._rows.items() if len(row) > 1}
        if not rows:
            return False
        columns = ["", *(run for run in self._runs if any(run in row for row in rows.values()))]
        heights = [max(map(_height, row.values())) for row in rows.values()]
        width = _GAP + len(columns) * (_WIDTH + _GAP)
        sheet = np.full((_LINE + sum(_LINE + height for height in heights), width, 3), 255, np.uint8)
        for k, run in enumerate(columns):
            draw_text(sheet, run, (_GAP + k * (_WIDTH + _GAP), _LINE // 2), _INK, max_width=_WIDTH)
        top = _LINE
        for (scene, row), height in zip(rows.items(), heights, strict=True):
            draw_text(sheet, scene, (_GAP, top + _LINE // 2), _INK, max_width=_WIDTH)
            for k, run in enumerate(columns):
                y, x = top + _LINE, _GAP + k * (_WIDTH + _GAP)
                for picture in row.get(run, ()):
                    sheet[y : y + len(picture), x : x + _WIDTH] = picture
                    y += len(picture) + _GAP
            top += _LINE + height
        write_png(path, sheet)
        return True


def _small(picture: Picture) -> Picture:
    height = max(1, round(picture.shape[0] * _WIDTH / picture.shape[1]))
    shrink = cv2.INTER_AREA if picture.shape[1] > _WIDTH else cv2.INTER_NEAREST
    return np.asarray(cv2.resize(picture, (_WIDTH, min(height, 2 * _WIDTH)), interpolation=shrink), np.uint8)


def _height(pictures: Sequence[Picture]) -> int:
    return sum(len(picture) + _GAP for picture in pictures)
