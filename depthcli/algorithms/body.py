"""Mask of the body in a medical volume, without the air around it."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.maps import Floats, Image8, Mask

_AIR_LEVEL = 0.1  # share of the intensity range; darker pixels are air
_ENDS = (0.5, 99.5)  # percentiles of the values that become black and white
_CROSS = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], np.uint8)


def body(grey: Image8) -> Mask:
    """Select the pixels, (H, W) bool, of tissue and enclosed air in a slice of (H, W) uint8 grey levels."""
    tissue: NDArray[Any] = (grey > _AIR_LEVEL * 255).astype(np.uint8)
    tissue = cv2.morphologyEx(cv2.morphologyEx(tissue, cv2.MORPH_OPEN, _CROSS), cv2.MORPH_CLOSE, _CROSS, iterations=2)
    outlines, _ = cv2.findContours(np.asarray(tissue, np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    filled = cv2.drawContours(np.zeros(grey.shape, np.uint8), outlines, -1, 1, cv2.FILLED)
    return np.asarray(filled > 0, np.bool_)


def grey_levels(values: Floats) -> Image8:
    """Return a volume as grey levels, scaled between its 0.5 % and 99.5 % percentiles; NaN becomes black."""
    known = values[np.isfinite(values)]
    low, high = np.percentile(known, _ENDS) if known.size else (0.0, 1.0)
    grey = (np.nan_to_num(values, nan=low) - low) * (255 / max(high - low, 1e-9))
    levels: Image8 = np.clip(grey, 0, 255).astype(np.uint8)
    return levels


def body_of_volume(values: Floats) -> Mask:
    """Return the mask of the body, (Z, Y, X) bool, in every axial slice of a (Z, Y, X) volume."""
    return np.stack([body(plane) for plane in grey_levels(values)])
