"""The second Middlebury evaluation: bad pixels in non-occluded, all and discontinuity regions."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.filters import discontinuity_mask
from depthcli.evaluation.protocols._disparity import PRESENTATION, DisparityProtocol, Masks
from depthcli.io.stereo_pairs import StereoTruth


class MiddleburyV2Protocol(DisparityProtocol):
    """Bad-pixel rates.

    A pixel is bad if ``|d - d_true| > t`` or if it has no value (Scharstein & Szeliski, IJCV 2002, eq. 2; the
    online evaluation's rule for missing values). The average and root-mean-square errors are over the
    estimated pixels. Missing masks are derived if the ground truth of both views is known.
    """

    presentation = replace(PRESENTATION, title="Middlebury v2: bad pixels, %; missing counts as bad", scene_rows=False)
    thresholds: ClassVar[tuple[float, ...]] = (0.5, 0.75, 1.0, 1.5, 2.0)
    default_threshold = 1.0
    averages_regions = True

    def masks(self, stored: StereoTruth) -> Masks:
        """Return the masks of the files; missing masks are derived."""
        masks = super().masks(stored)
        if stored.right is not None and stored.right.shape == stored.disparity.shape:
            masks = {**derive_masks(stored.disparity, stored.right, masks.get("nonocc")), **masks}
        return masks


def derive_masks(
    left: NDArray[np.float32], right: NDArray[np.float32], nonocc: NDArray[np.bool_] | None = None
) -> dict[str, NDArray[np.bool_]]:
    """Compute evaluation masks from the ground truth of both views, in the way of Middlebury v2.

    Parameters
    ----------
    left, right : (H, W) float32, pixels, NaN = unknown
    nonocc : (H, W) bool, a known mask that replaces the derived one

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
    with np.errstate(over="ignore"):  # damaged truth may have any number
        disc = discontinuity_mask(filled, nonocc, known)
    return {"nonocc": nonocc, "all": known, "disc": disc}
