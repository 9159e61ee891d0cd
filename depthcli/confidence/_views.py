"""Measures that ask the right view, read from the left view's volume along its diagonals."""

from __future__ import annotations

from typing import Any

import numpy as np

from depthcli.kernels.jit import parallel_jit, prange


@parallel_jit
def measure_views(costs: Any, eps: Any, margin: Any, consistency: Any, distinctness: Any, right: Any) -> None:
    """LRC, LRD and the right view's winners (int32) of (H, W, D) costs; cells with d > x take no part.

    ``margin`` is (H, W) float32 c2 - c1 and only read for LRD. Ties go to the smaller disparity.
    """
    height, width, depth = costs.shape
    for y in prange(height):
        # Right pixel x - d is stored at W - 1 - (x - d): along d both streams run forwards.
        cheapest = np.full(width + depth, np.float32(np.inf), np.float32)
        chosen = np.zeros(width + depth, np.int32)
        for x in range(width):
            row = costs[y, x, : min(depth, x + 1)]
            values = cheapest[width - 1 - x : width - 1 - x + row.size]
            places = chosen[width - 1 - x : width - 1 - x + row.size]
            for i in range(row.size):
                v = np.float32(row[i])
                better = v < values[i]
                places[i] = np.int32(i) if better else places[i]
                values[i] = v if better else values[i]
        for x in range(width):
            right[y, x] = chosen[width - 1 - x]
            row = costs[y, x, : min(depth, x + 1)]
            lowest = row[0]
            for i in range(row.size):
                lowest = min(lowest, row[i])
            d = 0
            while row[d] != lowest:
                d += 1
            partner = width - 1 - x + d
            consistency[y, x] = -np.float32(abs(d - chosen[partner]))
            distinctness[y, x] = margin[y, x] / (np.float32(lowest) - cheapest[partner] + eps)
