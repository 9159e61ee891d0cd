import numpy as np

from depthcli.methods.confidence import ConfidenceMeasure, CostCurves, Map


class NaiveWinnerMargin(ConfidenceMeasure):
    """Naive winner margin: (c2 - c1) / sum of c."""

    def __call__(self, curves: CostCurves) -> Map:
        statistics = curves.statistics
        return (statistics.second_lowest - statistics.lowest) * (np.float32(1) / (statistics.total + statistics.eps))
