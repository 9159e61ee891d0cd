from depthcli.methods.confidence import ConfidenceMeasure, CostCurves, Map


class Curvature(ConfidenceMeasure):
    """Curvature at the minimum: c(d1 - 1) + c(d1 + 1) - 2 c1."""

    def __call__(self, curves: CostCurves) -> Map:
        return curves.statistics.curvature
