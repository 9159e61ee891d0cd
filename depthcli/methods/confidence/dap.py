"""Disparity agreement of both views, times peak ratio."""

from __future__ import annotations

from typing import Any

import numpy as np

from depthcli.kernels.jit import parallel_jit, prange
from depthcli.methods.confidence import ConfidenceMeasure, CostCurves, Map
from depthcli.methods.confidence.apkr import AveragePeakRatio
from depthcli.methods.confidence.da import agreement

_RADIUS = 6  # half of the window, pixels


class AgreementAndPeak(ConfidenceMeasure):
    """Disparity agreement and peak: agreement in both views of a stereo volume times sqrt(1 - 1 / apkr).

    The windows are 13 x 13 pixels, in the left view around the pixel, in the right view around its match.
    """

    def __call__(self, curves: CostCurves) -> Map:
        winner = curves.statistics.winner
        of_right = np.empty(winner.shape, np.float32)
        _mutual_agreement(winner, curves.stereo_winners[1], _RADIUS, of_right)
        distinct = np.sqrt(np.maximum(1 - 1 / AveragePeakRatio()(curves), 0))
        return (agreement(winner, _RADIUS) * of_right * distinct).astype(np.float32)


@parallel_jit
def _mutual_agreement(winner: Any, right: Any, radius: int, out: Any) -> None:
    # The share of the window around the match, in the right view's map, that is within 1 of the pixel's disparity.
    height, width = winner.shape
    for y in prange(height):
        top, bottom = max(0, y - radius), min(height, y + radius + 1)
        for x in range(width):
            d = winner[y, x]
            left, stop = max(0, x - d - radius), min(width, x - d + radius + 1)
            count = np.int32(0)
            for q in range(top, bottom):
                row = right[q, left:stop]
                for i in range(row.size):
                    count += np.int32(abs(row[i] - d) <= 1)
            out[y, x] = np.float32(count) / np.float32((stop - left) * (bottom - top))
