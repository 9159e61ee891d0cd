"""Spread of the costs."""

from depthcli.methods.confidence import ConfidenceMeasure, CostCurves, Map


class Spread(ConfidenceMeasure):
    """Spread: largest cost - c1."""

    def __call__(self, curves: CostCurves) -> Map:
        """Return the difference in units of the costs."""
        return curves.costs.max(axis=-1).astype("float32") - curves.statistics.lowest
