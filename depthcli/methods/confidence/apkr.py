"""Average peak ratio (Kim et al. 2014)."""

from __future__ import annotations

from typing import Any

import numpy as np

from depthcli.kernels.jit import parallel_jit, prange
from depthcli.methods.confidence import ConfidenceMeasure, CostCurves, Map

_RADIUS = 2  # half of the window, pixels


class AveragePeakRatio(ConfidenceMeasure):
    """Average peak ratio: mean of c(d2m) / c(d1) in 5 x 5 pixels, at the disparities of the center."""

    def __call__(self, curves: CostCurves) -> Map:
        known = curves.statistics
        out = np.empty(known.winner.shape, np.float32)
        _average_peak_ratio(
            curves.costs, curves.valid, known.winner, known.second_winner, np.float32(known.eps), _RADIUS, out
        )
        return out


@parallel_jit
def _average_peak_ratio(costs: Any, valid: Any, winner: Any, second: Any, eps: Any, radius: int, out: Any) -> None:
    height, width, _ = costs.shape
    for y in prange(height):
        for x in range(width):
            if second[y, x] < 0:
                out[y, x] = 1.0
                continue
            first, rival = winner[y, x], second[y, x]
            total = np.float32(0.0)
            count = 0
            for q in range(max(0, y - radius), min(height, y + radius + 1)):
                for p in range(max(0, x - radius), min(width, x + radius + 1)):
                    if first < valid[q, p] and rival < valid[q, p]:
                        total += (np.float32(costs[q, p, rival]) + eps) / (np.float32(costs[q, p, first]) + eps)
                        count += 1
            out[y, x] = total / np.float32(count)
