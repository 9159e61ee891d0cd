from depthcli.methods.confidence import ConfidenceMeasure, CostCurves, Map


class NegativeEntropy(ConfidenceMeasure):
    """Negative entropy: sum of p log p for p = softmax(-4 c / s), s the standard deviation of all costs."""

    def __call__(self, curves: CostCurves) -> Map:
        return curves.statistics.negative_entropy
