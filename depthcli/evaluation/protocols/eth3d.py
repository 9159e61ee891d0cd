"""The two-view evaluation of ETH3D, as its program ``two-view-evaluation`` computes its metrics."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from depthcli.evaluation.protocols._disparity import PRESENTATION, Disparity, DisparityProtocol, DisparityTruth
from depthcli.evaluation.scores import Metric, Score

MISSING_NOT_COUNTED = "estimated pixels only; an empty map counts as bad"


class Eth3dProtocol(DisparityProtocol):
    """Bad pixels among the estimated ones, with their coverage.

    Values may be negative; they are neither clipped nor rounded. A value larger than the image's width counts as
    missing. A map without any value is 100 % bad. The quantile A_q is element floor(q n / 100) of the n sorted errors.
    """

    presentation = replace(
        PRESENTATION,
        title="ETH3D two-view: bad pixels among the estimated ones, %",
        note="bad: % of the estimated pixels; coverage: % of all pixels; avgerr, rms, A50 ...: px, estimated pixels",
    )
    thresholds = (0.5, 1.0, 2.0, 4.0)
    default_threshold = 1.0
    thresholded_metric = Metric("bad", "%", convention=MISSING_NOT_COUNTED, worst=100.0)

    def lowest(self, truth: DisparityTruth) -> float:
        """Return minus the image's width: negative values count, as in the benchmark's program."""
        return -float(truth.values.shape[1])

    def values(self, estimate: Disparity, truth: DisparityTruth) -> Disparity:
        """Return the estimate without values whose size exceeds the image's width."""
        fitted = super().values(estimate, truth)
        with np.errstate(invalid="ignore"):
            return np.where(fitted > fitted.shape[1], np.float32(np.nan), fitted)

    def scores(self, estimate: Disparity, truth: DisparityTruth) -> list[Score]:
        scores = []
        for tally in self.tallies(estimate, truth):
            valid, n_valid = tally.valid, tally.valid.size
            for t in self.all_thresholds:
                scores.append(tally.rate(self.at(t), valid > np.float32(t) if n_valid else np.isnan(tally.error)))
            coverage = Metric("coverage", "%", worst=0.0, larger_is_better=True)
            mean, rms = tally.means()
            # In single precision, as there; the places of the quantiles too.
            square = float(np.mean(valid * valid, dtype=np.float64)) if n_valid else math.nan
            rms = replace(rms, value=float(np.sqrt(np.float32(square))))
            scores += [tally.number(coverage, tally.density, tally.error.size), mean, rms]
            scores += tally.quantiles(lambda q, n: int(np.float32(n) * np.float32(q / 100)))
        return scores
