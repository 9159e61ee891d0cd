"""Naive peak ratio."""

from __future__ import annotations

import numpy as np

from depthcli.methods.confidence import ConfidenceMeasure, CostCurves, Map


class NaivePeakRatio(ConfidenceMeasure):
    """Naive peak ratio: c2 / c1."""

    def __call__(self, curves: CostCurves) -> Map:
        known = curves.statistics
        return (known.second_lowest + known.eps) * (np.float32(1) / (known.lowest + known.eps))
