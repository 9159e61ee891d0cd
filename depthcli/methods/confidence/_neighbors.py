"""Measures that look at the pixels around."""

from __future__ import annotations

from typing import Any

import numpy as np

from depthcli.kernels.jit import parallel_jit, prange


@parallel_jit
def agreement(winner: Any, radius: int, out: Any) -> None:
    """Share of the window's pixels whose winner lies within 1 of the center's, (H, W)."""
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


@parallel_jit
def mutual_agreement(winner: Any, right: Any, radius: int, out: Any) -> None:
    """The same share in the right view's map, in the window around the match, (H, W)."""
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


@parallel_jit
def average_peak_ratio(costs: Any, valid: Any, winner: Any, second: Any, eps: Any, radius: int, out: Any) -> None:
    """Mean over the window of c_q(d2m) / c_q(d1), with the center's d1 and d2m (Kim et al. 2014)."""
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
