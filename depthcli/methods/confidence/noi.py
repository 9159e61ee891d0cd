from depthcli.methods.confidence import ConfidenceMeasure, CostCurves, Map


class NumberOfMinima(ConfidenceMeasure):
    """Number of inflections: -(number of local minima of the smoothed curve).

    The name is Hu and Mordohai's; minima are counted, not inflections.
    """

    def __call__(self, curves: CostCurves) -> Map:
        return -curves.statistics.n_minima
