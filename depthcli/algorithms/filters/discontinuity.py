"""Where a disparity map jumps."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray


def discontinuity_mask(
    disparity: NDArray[np.floating[Any]],
    nonocc: NDArray[np.bool_],
    known: NDArray[np.bool_] | None = None,
    gap: float = 2.0,
) -> NDArray[np.bool_]:
    """Visible pixels near a depth discontinuity, as the ``disc`` masks of Middlebury v2 have them.

    A 9x9 dilation of the 4-neighbor jumps above ``gap`` and of the occluded pixels, inside ``nonocc``.

    Parameters
    ----------
    disparity : (H, W) float, pixels, finite
    nonocc : (H, W) bool, visible in both views
    known : (H, W) bool; pixels that are neither known nor visible are not taken for occluded. None: all are known
    gap : pixels
    """
    edge = ~nonocc if known is None else known & ~nonocc
    across, down = np.abs(np.diff(disparity, axis=1)) > gap, np.abs(np.diff(disparity, axis=0)) > gap
    edge[:, 1:] |= across
    edge[:, :-1] |= across
    edge[1:] |= down
    edge[:-1] |= down
    near: NDArray[np.bool_] = cv2.dilate(edge.astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
    return near & nonocc
