from depthcli.methods.confidence import ConfidenceMeasure, CostCurves, Map


class MaximumMargin(ConfidenceMeasure):
    """Maximum margin: second smallest local minimum - c1."""

    def __call__(self, curves: CostCurves) -> Map:
        return curves.statistics.second_minimum - curves.statistics.lowest
