"""Codes 0 .. 255 of real numbers, on one scale for both volumes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_MIN_RANGE = 1e-35  # smaller ranges count as none: float32 cannot hold 255 levels over them


def levels(
    fixed: NDArray[np.float32], warped: NDArray[np.float32], outliers: float
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Map both arrays from their common percentiles, ``outliers`` percent cut off at either end, to 0 .. 255."""
    both = np.concatenate([fixed.ravel(), warped.ravel()])
    low, high = (float(v) for v in np.percentile(both, [outliers, 100 - outliers]))
    if high - low < _MIN_RANGE:
        low, high = float(both.min()), float(both.max())
    scale = np.float32(255 / (high - low) if high - low >= _MIN_RANGE else 0)
    one, other = (
        np.rint((np.clip(values, np.float32(low), np.float32(high)) - np.float32(low)) * scale).clip(0, 255)
        for values in (fixed, warped)
    )
    return one.astype(np.uint8), other.astype(np.uint8)
