"""The colors of the page: of values, and of errors by kind of pixel."""

from __future__ import annotations

from functools import cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

NO_VALUE = (90, 90, 90)
"""RGB of a pixel of a map that has no value; no color of the map's scale."""

# By kind of pixel, from a small error to a large one. Blue and orange stay apart for every kind of color blindness,
# purple is apart from both by lightness too; the darker, the worse.
_RAMPS = (
    ("#ffffff", "#ffffff"), ("#c6dff2", "#2f7ab8"), ("#f5b13d", "#8a3000"), ("#dcdcdc", "#9b9b9b"),
    ("#dba2cf", "#5c1f57"), ("#000000", "#000000"),
)  # fmt: skip


@cache
def map_colors() -> NDArray[np.uint8]:
    """Return (256, 3) RGB of the map's scale: viridis, perceptually uniform, readable without color vision."""
    grey = np.arange(256, dtype=np.uint8)[:, None]
    table: NDArray[Any] = cv2.applyColorMap(grey, cv2.COLORMAP_VIRIDIS)[:, 0, ::-1]
    return np.ascontiguousarray(table, np.uint8)


@cache
def error_scales() -> NDArray[np.uint8]:
    """Return (6, 64, 3) RGB by kind of pixel and size of the error, as the page's script indexes them, too."""
    share = np.linspace(0, 1, 64)[:, None]
    ends = [[np.array([int(end[k : k + 2], 16) for k in (1, 3, 5)]) for end in ramp] for ramp in _RAMPS]
    return np.stack([np.rint(first + share * (last - first)) for first, last in ends]).astype(np.uint8)


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
