"""Naive winner margin."""

from __future__ import annotations

import numpy as np

from depthcli.methods.confidence import ConfidenceMeasure, CostCurves, Map


class NaiveWinnerMargin(ConfidenceMeasure):
    """Naive winner margin: (c2 - c1) / sum of c."""

    def __call__(self, curves: CostCurves) -> Map:
        known = curves.statistics
        return (known.second_lowest - known.lowest) * (np.float32(1) / (known.total + known.eps))
