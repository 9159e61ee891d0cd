"""Colors of the page, as tables that are indexed in the same way here and in the page's script."""

from __future__ import annotations

from functools import cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.evaluation.protocols import EMPTY, HIDDEN_RIGHT, HIDDEN_WRONG, RIGHT, UNKNOWN, WRONG

# From a small error to a large one. Blue and orange stay apart for every kind of color blindness, purple is apart from
# both by lightness too; the darker, the worse.
_RAMPS = {
    UNKNOWN: ("#ffffff", "#ffffff"),
    RIGHT: ("#c6dff2", "#2f7ab8"),
    WRONG: ("#f5b13d", "#8a3000"),
    HIDDEN_RIGHT: ("#dcdcdc", "#9b9b9b"),
    HIDDEN_WRONG: ("#dba2cf", "#5c1f57"),
    EMPTY: ("#000000", "#000000"),
}
NO_VALUE = (90, 90, 90)
"""RGB of a pixel of a map that has no value; no color of the map's scale."""


@cache
def map_colors() -> NDArray[np.uint8]:
    """Return (256, 3) RGB of the map's scale: viridis, perceptually uniform, readable without color vision."""
    grey = np.arange(256, dtype=np.uint8)[:, None]
    table: NDArray[Any] = cv2.applyColorMap(grey, cv2.COLORMAP_VIRIDIS)[:, 0, ::-1]
    return np.ascontiguousarray(table, np.uint8)


@cache
def error_scales() -> NDArray[np.uint8]:
    """Return (6, 64, 3) RGB by kind of pixel and size of the error."""
    share = np.linspace(0, 1, 64)[:, None]
    ends = [[np.array([int(end[k : k + 2], 16) for k in (1, 3, 5)]) for end in _RAMPS[kind]] for kind in range(6)]
    return np.stack([np.rint(first + share * (last - first)) for first, last in ends]).astype(np.uint8)


def map_picture(values: NDArray[np.floating[Any]], low: float, high: float) -> NDArray[np.uint8]:
    """Return (H, W) numbers as (H, W, 3) RGB of the scale over [low, high]."""
    picture = map_colors()[_index(values, low, high, 256)]
    picture[np.isnan(values)] = NO_VALUE
    return picture


def shaded_picture(kind: NDArray[np.uint8], error: NDArray[np.floating[Any]], top: float) -> NDArray[np.uint8]:
    """Return (H, W, 3) RGB: hue by kind of pixel, lightness by error, the darkest from ``top`` on."""
    return error_scales()[kind, _index(error, 0.0, top, 64)]


def overlaid(
    picture: NDArray[np.uint8], nothing: NDArray[np.bool_], beneath: NDArray[np.uint8] | None, opacity: float
) -> NDArray[np.uint8]:
    """Return the (H, W, 3) RGB picture of a map blended with the image ``beneath``, which is alone at ``nothing``."""
    if beneath is None or opacity >= 1:
        return picture
    mixed = np.rint(opacity * picture + (1 - opacity) * beneath).astype(np.uint8)
    return np.where(nothing[..., None], beneath, mixed)


def _index(values: NDArray[np.floating[Any]], low: float, high: float, steps: int) -> NDArray[np.intp]:
    share = (np.clip(np.nan_to_num(values.astype(np.float64), nan=low), low, max(high, low)) - low) / max(
        high - low, 1e-9
    )
    index: NDArray[np.intp] = np.clip((share * steps).astype(np.intp), 0, steps - 1)
    return index
