"""The evaluation of the Scene Flow data sets that is usual in papers on networks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from depthcli.evaluation.protocols import Settings
from depthcli.evaluation.protocols._disparity import PRESENTATION, Disparity, DisparityProtocol, DisparityTruth, Masks
from depthcli.evaluation.protocols.kitti_2015 import is_d1
from depthcli.evaluation.scores import ESTIMATED_ONLY, MISSING_IS_BAD, Metric, Score
from depthcli.io.stereo_pairs import StereoTruth

_RANGE = 192.0  # pixels: true disparities from here on are not evaluated
_WRONG = 3.0  # pixels; a larger error is shown as incorrect


class SceneFlowProtocol(DisparityProtocol):
    """End-point error over the pixels whose true disparity is between 0 and 192 px (as GwcNet and RAFT-Stereo).

    ``avgerr`` is the end-point error over the estimated pixels. ``bad`` counts errors above 1, 2 and 3 px, and ``D1``
    counts errors above 3 px and 5 % of the ground truth; missing values are bad in both. In a mean, all frames have
    one weight.
    """

    presentation = replace(
        PRESENTATION,
        title="Scene Flow: end-point error, px, of true disparities below 192 px",
        note="avgerr, rms: px, estimated pixels; bad, D1 (> 3 px and > 5 %): % of the pixels, missing counts as bad",
    )
    thresholds = (1.0, 2.0, 3.0)
    default_threshold = _WRONG

    def __init__(self, settings: Settings | None = None) -> None:
        super().__init__(settings)
        if self.settings.threshold is None:  # else the share of errors above the user's
            self.headline = Metric("avgerr", "px", convention=ESTIMATED_ONLY)

    def masks(self, stored: StereoTruth) -> Masks:
        """Return the masks of the files within the range that is evaluated."""
        with np.errstate(invalid="ignore"):
            inside = (stored.disparity > 0) & (stored.disparity < _RANGE)
        return {name: mask & inside for name, mask in super().masks(stored).items()}

    def wrong(self, estimate: Disparity, truth: DisparityTruth) -> NDArray[np.bool_]:
        """Return True for pixels whose error exceeds 3 px, or the user's threshold."""
        return self.error(estimate, truth) > np.float32(self.settings.threshold or _WRONG)

    def scores(self, estimate: Disparity, truth: DisparityTruth) -> list[Score]:
        scores = []
        for tally, region in zip(self.tallies(estimate, truth), truth.regions.values(), strict=True):
            missing = np.isnan(tally.error)
            scores += tally.means()
            scores += [tally.rate(self.at(t), ~(tally.error <= np.float32(t))) for t in self.all_thresholds]
            d1 = Metric("D1", "%", 3.0, MISSING_IS_BAD, 100.0, label="D1")
            scores.append(tally.rate(d1, is_d1(tally.error, truth.values[region]) | missing))
        return scores
