"""Cells of a cost volume whose match lies outside the right image."""

from __future__ import annotations

from typing import Any

from depthcli.kernels.jit import parallel_jit, prange


@parallel_jit
def fill_outside(costs: Any, outside: Any) -> None:
    """Set the cells of (H, W, D) costs whose match lies outside the right image, d > x."""
    height, width, depth = costs.shape
    for y in prange(height):
        for x in range(min(width, depth - 1)):
            for d in range(x + 1, depth):
                costs[y, x, d] = outside
