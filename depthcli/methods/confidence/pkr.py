"""Peak ratio."""

from __future__ import annotations

import numpy as np

from depthcli.methods.confidence import ConfidenceMeasure, CostCurves, Map


class PeakRatio(ConfidenceMeasure):
    """Peak ratio: second smallest local minimum / c1."""

    def __call__(self, curves: CostCurves) -> Map:
        known = curves.statistics
        return (known.second_minimum + known.eps) * (np.float32(1) / (known.lowest + known.eps))
