"""Disparity agreement."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.kernels.jit import parallel_jit, prange
from depthcli.methods.confidence import ConfidenceMeasure, CostCurves, Map

_RADIUS = 12  # half of the window, pixels


class DisparityAgreement(ConfidenceMeasure):
    """Disparity agreement: share of a 25 x 25 window whose d1 is within 1 pixel of the center's."""

    def __call__(self, curves: CostCurves) -> Map:
        return agreement(curves.statistics.winner, _RADIUS)


def agreement(winner: NDArray[np.int32], radius: int) -> Map:
    """Return the share of the window around each pixel whose winner is within 1 of the pixel's own, (H, W) float32.

    Parameters
    ----------
    winner : (H, W), index of the smallest cost
    radius : half the side of the window, pixels
    """
    out = np.empty(winner.shape, np.float32)
    _agreement(winner, radius, out)
    return out


@parallel_jit
def _agreement(winner: Any, radius: int, out: Any) -> None:
    height, width = winner.shape
    for y in prange(height):
        top, bottom = max(0, y - radius), min(height, y + radius + 1)
        count = np.zeros(width, np.int32)
        for q in range(top, bottom):
            for dx in range(-radius, radius + 1):
                start, stop = max(0, -dx), min(width, width - dx)
                if stop <= start:
                    continue
                tally = count[start:stop]
                center = winner[y, start:stop]
                other = winner[q, start + dx : stop + dx]
                for i in range(tally.size):
                    tally[i] += np.int32(abs(other[i] - center[i]) <= 1)
        for x in range(width):
            columns = min(width, x + radius + 1) - max(0, x - radius)
            out[y, x] = np.float32(count[x]) / np.float32(columns * (bottom - top))
