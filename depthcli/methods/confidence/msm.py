from depthcli.methods.confidence import ConfidenceMeasure, CostCurves, Map


class MatchingScore(ConfidenceMeasure):
    """Matching score: -c1."""

    def __call__(self, curves: CostCurves) -> Map:
        return -curves.statistics.lowest
