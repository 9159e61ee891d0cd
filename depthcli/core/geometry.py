"""Disparity, depth and raw sensor codes: the triangulation formulas, in one place."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def depth_of_disparity(disparity: NDArray[np.floating[Any]], fb: float, offset: float = 0.0) -> NDArray[np.float32]:
    """Depth ``fb / (d + offset)`` of a rectified pair.

    Parameters
    ----------
    disparity : pixels, NaN = unknown
    fb : focal length x baseline, pixel meters
    offset : difference of the principal points (``doffs`` of Middlebury v3), pixels

    Returns
    -------
    float32, meters; NaN where the disparity is unknown or the point is not in front of the cameras
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = (fb / (disparity.astype(np.float64) + offset)).astype(np.float32)
    depth[~(np.isfinite(depth) & (depth > 0))] = np.nan
    return depth


def disparity_of_depth(depth: NDArray[np.floating[Any]], fb: float, offset: float = 0.0) -> NDArray[np.float32]:
    """The inverse of :func:`depth_of_disparity`; float32, pixels, NaN where the depth is unknown or not positive."""
    with np.errstate(divide="ignore", invalid="ignore"):
        disparity = (fb / depth.astype(np.float64) - offset).astype(np.float32)
    disparity[~(np.isfinite(disparity) & (depth > 0))] = np.nan
    return disparity
