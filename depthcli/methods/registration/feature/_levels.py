"""Codes 0 .. 255 of real numbers, on one scale for both volumes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def levels(
    fixed: NDArray[np.float32], warped: NDArray[np.float32], outliers: float
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Map both arrays from their common percentiles, ``outliers`` percent cut off at either end, to 0 .. 255."""
    both = np.concatenate([fixed.ravel(), warped.ravel()])
    low, high = (float(v) for v in np.percentile(both, [outliers, 100 - outliers]))
    if high <= low:
        low, high = float(both.min()), float(both.max())
    scale = np.float32(255 / (high - low)) if high > low else np.float32(0)
    one, other = (
        np.clip(np.rint((values - np.float32(low)) * scale), 0, 255).astype(np.uint8) for values in (fixed, warped)
    )
    return one, other
