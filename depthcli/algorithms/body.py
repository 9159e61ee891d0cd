"""The body in a slice of a medical volume, apart from the air around it."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

_AIR_LEVEL = 0.1  # of the range of intensities: darker pixels are air
_ENDS = (0.5, 99.5)  # percentiles of the values that grey levels lie between
_CROSS = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], np.uint8)


def body(grey: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Return (H, W) bool, where a slice of (H, W) uint8 grey levels shows tissue, or air that tissue encloses."""
    tissue: NDArray[Any] = (grey > _AIR_LEVEL * 255).astype(np.uint8)
    tissue = cv2.morphologyEx(cv2.morphologyEx(tissue, cv2.MORPH_OPEN, _CROSS), cv2.MORPH_CLOSE, _CROSS, iterations=2)
    outlines, _ = cv2.findContours(np.asarray(tissue, np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    filled = cv2.drawContours(np.zeros(grey.shape, np.uint8), outlines, -1, 1, cv2.FILLED)
    return np.asarray(filled > 0, np.bool_)


def grey_levels(values: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return a volume as grey levels between its darkest and brightest half percent; NaN are dark."""
    known = values[np.isfinite(values)]
    low, high = np.percentile(known, _ENDS) if known.size else (0.0, 1.0)
    grey = (np.nan_to_num(values, nan=low) - low) * (255 / max(high - low, 1e-9))
    levels: NDArray[np.uint8] = np.clip(grey, 0, 255).astype(np.uint8)
    return levels


def body_of_volume(values: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return (Z, Y, X) bool, the body in every axial slice of a (Z, Y, X) volume."""
    return np.stack([body(plane) for plane in grey_levels(values)])
