"""The colors of values on the page and the contact sheet; those of errors are :func:`..protocols.error_scales`."""

from __future__ import annotations

from functools import cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.io.formats.pictures import NO_VALUE


@cache
def map_colors() -> NDArray[np.uint8]:
    """Return (256, 3) RGB of the map's scale: viridis, perceptually uniform, readable without color vision."""
    grey = np.arange(256, dtype=np.uint8)[:, None]
    table: NDArray[Any] = cv2.applyColorMap(grey, cv2.COLORMAP_VIRIDIS)[:, 0, ::-1]
    return np.ascontiguousarray(table, np.uint8)


def map_picture(values: NDArray[np.floating[Any]], low: float, high: float) -> NDArray[np.uint8]:
    """Return (H, W) numbers as (H, W, 3) RGB of the scale over [low, high]."""
    picture = map_colors()[step_of(values, low, high, 256)]
    picture[np.isnan(values)] = NO_VALUE
    return picture


def step_of(values: NDArray[np.floating[Any]], low: float, high: float, steps: int) -> NDArray[np.intp]:
    """Return the index of numbers, NaN the lowest, among equal steps over [low, high]."""
    known = np.clip(np.nan_to_num(values.astype(np.float64), nan=low), low, max(high, low))
    index: NDArray[np.intp] = np.clip(((known - low) / max(high - low, 1e-9) * steps).astype(np.intp), 0, steps - 1)
    return index
