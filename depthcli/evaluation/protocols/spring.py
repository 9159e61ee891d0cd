"""The stereo evaluation of Spring, as the code of its website computes its metrics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from depthcli.evaluation.pooling import pool_pixels
from depthcli.evaluation.protocols._disparity import (
    PRESENTATION,
    Disparity,
    DisparityProtocol,
    DisparityTruth,
)
from depthcli.evaluation.scores import MISSING_IS_BAD, Metric, Score


class SpringProtocol(DisparityProtocol):
    """Errors above 1 px, the mean error and D1, pooled over the pixels of all frames.

    The truth has four values for a pixel; the error is the smallest difference from any of them. Pixels of which one is
    unknown do not count. D1 are errors above 3 px and above 5 % of the largest of the four. Missing values, which the
    benchmark does not allow, count as bad and have no part in ``avgerr``.
    """

    presentation = replace(
        PRESENTATION,
        title="Spring: errors > 1 px, %; missing counts as bad",
        note="avgerr: px, estimated pixels; D1: > 3 px and > 5 %; means: all frames pooled",
        mean_heading="pooled",
    )
    thresholds = (1.0, 2.0, 3.0)
    default_threshold = 1.0

    def reference(self, truth: DisparityTruth, region: str) -> Disparity:
        """Return the largest of the four values, NaN where one is unknown."""
        return truth.disparity if truth.finer is None else _four(truth.finer).max(axis=-1)

    def error(self, estimate: Disparity, truth: DisparityTruth) -> Disparity:
        """Return (H, W) float32, pixels: the smallest difference from the four values."""
        if truth.finer is None:
            return super().error(estimate, truth)
        with np.errstate(over="ignore", invalid="ignore"):
            error: Disparity = np.abs(_four(truth.finer) - self.resized(estimate, truth)[..., None]).min(axis=-1)
        return error

    def scores(self, estimate: Disparity, truth: DisparityTruth) -> list[Score]:
        """Compute ``bad`` at three thresholds, ``avgerr`` and ``D1``."""
        scores = []
        for tally, (name, region) in zip(self.tallies(estimate, truth), self.regions(truth).items(), strict=True):
            error, largest = tally.error, np.abs(self.reference(truth, name)[region])
            scores += [tally.rate(self.at(t), ~(error <= np.float32(t))) for t in self.all_thresholds]
            d1 = Metric("D1", "%", 3.0, MISSING_IS_BAD, 100.0, label="D1")
            scores += [tally.means()[0], tally.rate(d1, ~((error <= 3) | (error <= 0.05 * largest)))]
        return scores

    def pool(self, scores: Sequence[Score], weights: Sequence[float]) -> Score:
        """Compute a score over all pixels of all frames."""
        return pool_pixels(scores)


def _four(finer: Disparity) -> Disparity:
    """(H, W, 4) values of the pixels, of (2 H, 2 W) ones."""
    height, width = finer.shape[0] // 2, finer.shape[1] // 2
    return finer.reshape(height, 2, width, 2).transpose(0, 2, 1, 3).reshape(height, width, 4)
