from depthcli.methods.confidence import ConfidenceMeasure, CostCurves, Map


class AttainableMaximumLikelihood(ConfidenceMeasure):
    """Attainable maximum likelihood: 1 / sum of exp(-8 ((c - c1) / s)^2), s the standard deviation of all costs."""

    def __call__(self, curves: CostCurves) -> Map:
        return curves.statistics.attainable_likelihood
