"""Scanline optimization: dynamic programming along 4 or 8 paths (Hirschmueller 2008; Mei et al. 2011)."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numba import prange
from numpy.typing import NDArray
from pydantic import Field

from depthcli.core import memory
from depthcli.kernels._jit import jit, parallel_jit
from depthcli.stereo.aggregation._mean import FixedPoint, as_fixed_point
from depthcli.stereo.optimization import Optimizer
from depthcli.stereo.volume import CostVolume, StereoPair


class Scanline(Optimizer):
    """Mean of the cheapest path costs that end at a cell, over paths from 4 or 8 directions.

    ``L(p, d) = C(p, d) + min(L(q, d), L(q, d +- 1) + P1, min L(q) + P2) - min L(q)`` with q the pixel before
    p on the path. Where the left image has an edge between q and p both penalties are reduced.
    """

    p1: float = Field(0.5, gt=0, description="penalty of a disparity change by 1, in units of the cost")
    p2: float = Field(2.0, gt=0, description="penalty of a larger change, in units of the cost")
    paths: Literal[4, 8] = Field(8, description="number of path directions")
    edge_threshold: int = Field(10, ge=0, le=255, description="color difference that counts as an edge, grey levels")
    edge_divisor: float = Field(4.0, ge=1, description="penalties are divided by this across an edge")

    def __call__(self, volume: CostVolume, pair: StereoPair) -> CostVolume:
        if volume.costs.dtype == np.float32:
            volume = as_fixed_point(volume)
        costs = volume.costs
        # The penalties are capped so that sums of eight paths fit into 16 bits.
        p1, p2 = (round(min(p * volume.scale, FixedPoint.LARGEST)) for p in (self.p1, self.p2))
        table = np.array(
            [[p1, max(p1, p2)], [round(p1 / self.edge_divisor), round(max(p1, p2) / self.edge_divisor)]], np.uint16
        )
        edges = _path_edges(pair.color8[0], self.edge_threshold)
        sums = [memory.empty(costs.shape, np.uint16) for _ in range(2)]
        _sweep_both(costs, sums[0], sums[1], edges, table, self.paths == 8)
        _add(sums[0], sums[1])
        return CostVolume(sums[0], volume.scale * self.paths)


def _path_edges(image: NDArray[np.uint8], threshold: int) -> NDArray[np.uint8]:
    """(4, H, W) uint8: 1 where the pixel to the left, upper left, above, upper right differs in color."""
    height, width = image.shape[:2]
    edges = np.zeros((4, height, width), np.uint8)
    _mark_edges(np.ascontiguousarray(image.transpose(2, 0, 1)), edges, threshold)
    return edges


@parallel_jit
def _mark_edges(planes: Any, edges: Any, threshold: int) -> None:
    channels, height, width = planes.shape
    for y in prange(height):
        for k in range(4):
            dy = 0 if k == 0 else 1
            dx = -1 if k < 2 else k - 2
            if y - dy < 0:
                continue
            x0, x1 = max(0, -dx), min(width, width - dx)
            out = edges[k, y, x0:x1]
            for c in range(channels):
                here = planes[c, y, x0:x1]
                there = planes[c, y - dy, x0 + dx : x1 + dx]
                for i in range(out.size):
                    difference = np.int16(abs(np.int16(np.int16(here[i]) - np.int16(there[i]))))
                    out[i] = np.uint8(out[i] | np.uint8(difference > threshold))


@parallel_jit
def _add(total: Any, more: Any) -> None:
    height, width, depth = total.shape
    for y in prange(height):
        out = total[y].reshape(width * depth)
        source = more[y].reshape(width * depth)
        for i in range(out.size):
            out[i] = np.uint16(out[i] + source[i])


@parallel_jit
def _sweep_both(costs: Any, down: Any, up: Any, edges: Any, table: Any, diagonal: bool) -> None:
    for direction in prange(2):
        if direction == 0:
            _sweep(costs, down, edges, table, diagonal, False)
        else:
            _sweep(costs, up, edges, table, diagonal, True)


@jit
def _advance(costs: Any, before: Any, least: Any, p1: Any, p2: Any, after: Any, total: Any, first: bool) -> Any:
    """One pixel of one path: path costs ``after`` from those ``before``; both have a guard cell at each end.

    Path costs are stored less their own minimum, which is then 0.
    """
    depth = costs.size
    same = before[1 : depth + 1]
    lower = before[:depth]
    upper = before[2 : depth + 2]
    out = after[1 : depth + 1]
    smallest = np.uint16(0xFFFF)
    for i in range(out.size):
        jump = p2
        step = np.uint16(min(lower[i], upper[i]) + p1)
        best = min(same[i], jump)
        best = min(best, step)
        value = np.uint16(best + np.uint16(costs[i]))
        out[i] = value
        smallest = min(smallest, value)
    if first:
        for i in range(out.size):
            total[i] = out[i]
            out[i] = np.uint16(out[i] - smallest)
    else:
        for i in range(out.size):
            total[i] = np.uint16(total[i] + out[i])
            out[i] = np.uint16(out[i] - smallest)
    return smallest


@jit
def _sweep(costs: Any, sums: Any, edges: Any, table: Any, diagonal: bool, upwards: bool) -> None:
    """Paths from the left, upper left, above and upper right; upwards: their opposites."""
    height, width, depth = costs.shape
    guard = np.uint16(0x7FFF)
    zero = np.uint16(0)
    # rows[k, x + 1]: path costs of the row before, per direction; a margin pixel at each end starts paths anew
    old = np.full((3, width + 2, depth + 2), guard, np.uint16)
    new = np.full((3, width + 2, depth + 2), guard, np.uint16)
    old[:, :, 1 : depth + 1] = 0
    new[:, 0, 1 : depth + 1] = 0
    new[:, width + 1, 1 : depth + 1] = 0
    line = np.full((2, depth + 2), guard, np.uint16)
    step = -1 if upwards else 1
    for row in range(height):
        y = height - 1 - row if upwards else row
        line[:, 1 : depth + 1] = 0
        for column in range(width):
            x = width - 1 - column if upwards else column
            cost = costs[y, x]
            total = sums[y, x]
            # path along the row
            e = 0
            if column > 0:
                e = edges[0, y, x + 1] if upwards else edges[0, y, x]
            _advance(cost, line[column & 1], zero, table[e, 0], table[e, 1], line[1 - (column & 1)], total, True)
            # from above (below)
            e = 0
            if row > 0:
                e = edges[2, y + 1, x] if upwards else edges[2, y, x]
            _advance(cost, old[1, x + 1], zero, table[e, 0], table[e, 1], new[1, x + 1], total, False)
            if diagonal:
                u = x - step
                e = 0
                if row > 0 and 0 <= u < width:
                    e = edges[1, y + 1, u] if upwards else edges[1, y, x]
                _advance(cost, old[0, u + 1], zero, table[e, 0], table[e, 1], new[0, x + 1], total, False)
                u = x + step
                e = 0
                if row > 0 and 0 <= u < width:
                    e = edges[3, y + 1, u] if upwards else edges[3, y, x]
                _advance(cost, old[2, u + 1], zero, table[e, 0], table[e, 1], new[2, x + 1], total, False)
        old, new = new, old
