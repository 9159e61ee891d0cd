"""Disparity maps that have to be right to an eighth of a pixel."""

from dataclasses import replace

from depthcli.evaluation.protocols._disparity import PRESENTATION, Disparity, DisparityProtocol, DisparityTruth
from depthcli.evaluation.scores import Score


class EighthPixel(DisparityProtocol):
    """Bad pixels, missing ones included."""

    presentation = replace(PRESENTATION, title="Eighth of a pixel: bad pixels, %")
    thresholds = (0.125, 1.0)
    default_threshold = 0.125

    def scores(self, estimate: Disparity, truth: DisparityTruth) -> list[Score]:
        """Compute the share of pixels whose error is above each threshold."""
        return [
            tally.rate(self.at(threshold), ~(tally.error <= threshold))
            for tally in self.tallies(estimate, truth)
            for threshold in self.all_thresholds
        ]
