"""Results as files, one writer a kind of result."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.batch.record import to_csv
from depthcli.core.result import Result
from depthcli.io.atomic import write_text
from depthcli.io.disparity import write_disparity_png, write_pfm
from depthcli.io.images import write_png
from depthcli.stereo.volume import StereoResult


def save_stereo(result: StereoResult, folder: Path, max_disparity: int) -> None:
    """Write everything a stereo pipeline gave into the existing ``folder``."""
    values = result.disparity.values
    write_pfm(folder / "disp_left.pfm", values)
    write_disparity_png(folder / "disp_left.png", values)
    write_png(folder / "status.png", result.disparity.status)
    write_png(folder / "preview.png", preview(values, max_disparity))
    _save_rest(result, folder)


def _save_rest(result: Result, folder: Path) -> None:
    for name, confidence in result.confidence.items():
        write_pfm(folder / f"confidence_{name}.pfm", confidence)
    for name, rows in result.tables.items():
        write_text(folder / f"{name}.csv", to_csv(rows))
    for name, picture in result.pictures.items():
        write_png(folder / f"{name}.png", picture)


def preview(values: NDArray[np.float32], top: float) -> NDArray[np.uint8]:
    """(H, W, 3) RGB picture of a map for eyes: blue = 0 to red = ``top``, black = no value."""
    known = ~np.isnan(values)
    grey = np.zeros(values.shape, np.uint8)
    grey[known] = np.clip(np.rint(values[known] * (255.0 / max(top, 1e-6))), 0, 255).astype(np.uint8)
    picture: NDArray[Any] = cv2.applyColorMap(grey, cv2.COLORMAP_TURBO)[..., ::-1].copy()
    picture[~known] = 0
    return picture
