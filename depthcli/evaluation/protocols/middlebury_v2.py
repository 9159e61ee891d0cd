"""The second Middlebury evaluation: bad pixels in non-occluded, all and discontinuity regions."""

from __future__ import annotations

import numpy as np

from depthcli.data.scenes.stereo import StereoTruth
from depthcli.evaluation.disparity import Disparity, DisparityProtocol, DisparityTruth, Masks
from depthcli.evaluation.masks import derive_masks
from depthcli.evaluation.scores import Score


class MiddleburyV2(DisparityProtocol):
    """Bad-pixel rates.

    A pixel is bad if ``|d - d_true| > t`` or if it has no value (Scharstein & Szeliski, IJCV 2002, eq. 2; the
    online evaluation's rule for missing values). The average and root-mean-square errors beside them are over the
    estimated pixels. Masks that the files do not give are derived where both views' truth is known.
    """

    title = "Middlebury v2: bad pixels, %; missing counts as bad"
    thresholds = (0.5, 0.75, 1.0, 1.5, 2.0)
    default_threshold = 1.0
    averages_masks = True
    scene_rows = False

    def masks(self, stored: StereoTruth) -> Masks:
        """Those of the files, then derived ones."""
        masks = super().masks(stored)
        if stored.right is not None and stored.right.shape == stored.disparity.shape:
            masks = {**derive_masks(stored.disparity, stored.right, masks.get("nonocc")), **masks}
        return masks

    def scores(self, estimate: Disparity, truth: DisparityTruth) -> list[Score]:
        """``bad`` at five thresholds, ``avgerr`` and ``rms``."""
        scores = []
        for tally in self.tallies(estimate, truth):
            scores += [tally.rate(self.at(t), ~(tally.error <= np.float32(t))) for t in self.all_thresholds]
            scores += tally.means()
        return scores
