"""Evaluation masks that follow from the ground truth of both views."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.filters import discontinuity_mask


def derive_masks(
    left: NDArray[np.float32], right: NDArray[np.float32], nonocc: NDArray[np.bool_] | None = None
) -> dict[str, NDArray[np.bool_]]:
    """Evaluation masks from the ground truth of both views, as the Middlebury v2 ones were made.

    Parameters
    ----------
    left, right : (H, W) float32, pixels, NaN = unknown
    nonocc : (H, W) bool, where a better one is known than the one that would be derived

    Returns
    -------
    ``nonocc``, ``all``, ``disc`` : (H, W) bool. all: left truth known. nonocc: all, right truth at
    round(x - d) known and within 1 px. disc: near a jump of more than 2 px (unknown counted as 0) or an
    occluded pixel, inside nonocc.
    """
    known = ~np.isnan(left)
    filled = np.where(known, left, 0).astype(np.float32)
    if nonocc is None:
        rows, cols = np.indices(left.shape)
        target = cols - np.floor(filled + 0.5).astype(np.int64)
        other = right[rows, np.clip(target, 0, left.shape[1] - 1)]
        with np.errstate(invalid="ignore"):
            nonocc = known & (target >= 0) & (np.abs(other - left) <= 1)
    return {"nonocc": nonocc, "all": known, "disc": discontinuity_mask(filled, nonocc, known)}
