from depthcli.kernels.winners import left_right_difference
from depthcli.methods.confidence import ConfidenceMeasure, CostCurves, Map


class LeftRightConsistency(ConfidenceMeasure):
    """Left-right consistency: -|d1 - right view's d|."""

    def __call__(self, curves: CostCurves) -> Map:
        return -left_right_difference(*curves.views)
