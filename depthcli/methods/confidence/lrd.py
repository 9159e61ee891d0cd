import numpy as np

from depthcli.methods.confidence import ConfidenceMeasure, CostCurves, Map


class LeftRightDifference(ConfidenceMeasure):
    """Left-right difference: (c2 - c1) / (c1 - smallest cost of the right pixel), of a stereo volume."""

    def __call__(self, curves: CostCurves) -> Map:
        statistics = curves.statistics
        left, right = curves.stereo_winners
        rows, partner = np.arange(left.shape[0])[:, None], np.arange(left.shape[1]) - left.astype(np.int64)
        best = right[rows, partner].astype(np.int64)
        cheapest = curves.costs[rows, partner + best, best].astype(np.float32)
        lowest = statistics.lowest
        difference: Map = (statistics.second_lowest - lowest) / (lowest - cheapest + statistics.eps)
        return difference
