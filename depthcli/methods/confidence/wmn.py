import numpy as np

from depthcli.methods.confidence import ConfidenceMeasure, CostCurves, Map


class WinnerMargin(ConfidenceMeasure):
    """Winner margin: (second smallest local minimum - c1) / sum of c."""

    def __call__(self, curves: CostCurves) -> Map:
        statistics = curves.statistics
        return (statistics.second_minimum - statistics.lowest) * (np.float32(1) / (statistics.total + statistics.eps))
