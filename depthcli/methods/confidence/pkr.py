import numpy as np

from depthcli.methods.confidence import ConfidenceMeasure, CostCurves, Map


class PeakRatio(ConfidenceMeasure):
    """Peak ratio: second smallest local minimum / c1."""

    def __call__(self, curves: CostCurves) -> Map:
        statistics = curves.statistics
        return (statistics.second_minimum + statistics.eps) * (np.float32(1) / (statistics.lowest + statistics.eps))
