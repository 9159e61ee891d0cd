from depthcli.methods.confidence import ConfidenceMeasure, CostCurves, Map


class NumberOfMinima(ConfidenceMeasure):
    """Number of inflections: minus the number of local minima of the smoothed curve."""

    def __call__(self, curves: CostCurves) -> Map:
        return -curves.statistics.n_minima
