"""Winner margin."""

from __future__ import annotations

import numpy as np

from depthcli.methods.confidence import ConfidenceMeasure, CostCurves, Map


class WinnerMargin(ConfidenceMeasure):
    """Winner margin: (second smallest local minimum - c1) / sum of c."""

    def __call__(self, curves: CostCurves) -> Map:
        known = curves.statistics
        return (known.second_minimum - known.lowest) * (np.float32(1) / (known.total + known.eps))
