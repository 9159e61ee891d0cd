from depthcli.kernels.winners import left_right_difference
from depthcli.methods.confidence import ConfidenceMeasure, CostCurves, Map


class LeftRightConsistency(ConfidenceMeasure):
    """Left-right consistency: -abs(d1 - disparity of its match in the right view), of a stereo volume."""

    def __call__(self, curves: CostCurves) -> Map:
        return -left_right_difference(*curves.stereo_winners)
