from depthcli.methods.confidence import ConfidenceMeasure, CostCurves, Map


class NaiveMaximumMargin(ConfidenceMeasure):
    """Naive maximum margin: c2 - c1."""

    def __call__(self, curves: CostCurves) -> Map:
        return curves.statistics.second_lowest - curves.statistics.lowest
