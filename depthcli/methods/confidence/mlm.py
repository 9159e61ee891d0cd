from depthcli.methods.confidence import ConfidenceMeasure, CostCurves, Map


class MaximumLikelihood(ConfidenceMeasure):
    """Maximum likelihood: 1 / sum of exp(-2 (c - c1) / s), s the standard deviation of all costs."""

    def __call__(self, curves: CostCurves) -> Map:
        return curves.statistics.likelihood
