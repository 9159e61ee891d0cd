import numpy as np

from depthcli.methods.confidence import ConfidenceMeasure, CostCurves, Map


class NaivePeakRatio(ConfidenceMeasure):
    """Naive peak ratio: c2 / c1."""

    def __call__(self, curves: CostCurves) -> Map:
        statistics = curves.statistics
        return (statistics.second_lowest + statistics.eps) * (np.float32(1) / (statistics.lowest + statistics.eps))
