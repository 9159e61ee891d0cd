from depthcli.methods.confidence import ConfidenceMeasure, CostCurves, Map


class MaximumLikelihood(ConfidenceMeasure):
    """Maximum likelihood: exp(-2 c1) / sum of exp(-2 c), costs in standard deviations."""

    def __call__(self, curves: CostCurves) -> Map:
        return curves.statistics.likelihood
