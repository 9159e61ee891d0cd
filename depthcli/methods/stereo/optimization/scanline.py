"""Scanline optimization: dynamic programming along 4 or 8 paths (Hirschmueller 2008; Mei et al. 2011)."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.core import memory
from depthcli.core.frames import StereoPair
from depthcli.core.maps import Image8
from depthcli.kernels.color_steps import color_steps
from depthcli.kernels.jit import helper, jit, n_threads, run_bands
from depthcli.methods.stereo.optimization import Optimizer
from depthcli.methods.stereo.optimization._path_step import BYTE_LANES, LANES, path_step, prefetch
from depthcli.methods.stereo.volume import CostVolume, FixedPoint, as_fixed_point

_GUARD, _BYTE_GUARD = 0x7FFF, 0xFF  # above all path costs, in 16 or 8 bits
_BACK: NDArray[np.int64] = np.array([(0, 1), (1, 1), (1, 0), (1, -1)])  # to the previous pixels on downward paths
_TILE = 16, 96  # rows and columns that a thread computes at once, with more than 3 threads
_PADDING_COST = 20000  # of disparities added to fill a vector: above every cost, so that no path selects them


class Scanline(Optimizer):
    """Mean of the smallest costs of paths that end at a cell, from 4 or 8 directions.

    ``L(p, d) = C(p, d) + min(L(q, d), L(q, d +- 1) + P1, min L(q) + P2) - min L(q)`` with q the pixel before
    p on the path. Both penalties are reduced if the left image has an edge between q and p.
    """

    aliases = ("SGM", "SO")

    p1: float = Field(0.5, gt=0, le=1e6, description="penalty of a disparity change by 1, in units of the cost")
    p2: float = Field(2.0, gt=0, le=1e6, description="penalty of a disparity change above 1, in units of the cost")
    paths: Literal[4, 8] = Field(8, description="number of directions of scanline paths")
    edge_threshold: int = Field(10, ge=0, le=255, description="color difference that counts as an edge, grey levels")
    edge_divisor: float = Field(4.0, ge=1, le=1e4, description="p1 and p2 are divided by this across a color edge")

    def __call__(self, volume: CostVolume, pair: StereoPair) -> CostVolume:
        if volume.costs.dtype == np.float32:
            volume = as_fixed_point(volume)
        costs = volume.costs
        n_disparities = volume.n_disparities
        if n_disparities < LANES:  # the added ones are removed below
            padding = ((0, 0), (0, 0), (0, LANES - n_disparities))
            costs = np.pad(costs.astype(np.uint16), padding, constant_values=_PADDING_COST)
        table = self.penalties(volume.scale, volume.costs.dtype == np.uint8)
        in_bytes = costs.dtype == np.uint8 and n_disparities >= BYTE_LANES
        if in_bytes and int(table.max()) + int(costs.max()) < _BYTE_GUARD:
            table = table.astype(np.uint8)
        # 1 if the pixel to the left, upper left, above, upper right differs in color.
        edges = (color_steps(pair.color8[0], _BACK, largest=True) > self.edge_threshold).view(np.uint8)
        total = memory.empty(costs.shape, np.uint16)
        # Path costs of two sweeps, 0 between guard cells, and their minima; see _sweep.
        height, width = pair.shape
        n_states = 2 * height + 6 * (width + 2)
        state = np.full((2, n_states, costs.shape[2] + 2), _BYTE_GUARD if table.itemsize == 1 else _GUARD, table.dtype)
        state[:, :, 1:-1] = 0
        minima = np.zeros((2, n_states), table.dtype)
        _sweep_both(costs, total, edges, table, self.paths == 8, state.reshape(2, -1), minima)
        if n_disparities < LANES:
            total = np.ascontiguousarray(total[:, :, :n_disparities])
        return CostVolume(total, volume.scale * self.paths)

    def penalties(self, scale: float, raw: bool) -> NDArray[np.uint16]:
        """Return (2, 2) uint16: P1 and P2 in stored units, then both across an edge; ``raw``: costs are uint8."""
        # Sums of all paths have to fit into 16 bits; a path cost is at most the cost plus P2.
        largest = 65535 // self.paths - (255 if raw else FixedPoint.LARGEST)
        p1, p2 = (round(min(p * scale, largest)) for p in (self.p1, self.p2))
        return np.array(
            [[p1, max(p1, p2)], [round(p1 / self.edge_divisor), round(max(p1, p2) / self.edge_divisor)]], np.uint16
        )


def _sweep_both(
    costs: NDArray[Any],
    total: NDArray[np.uint16],
    edges: Image8,
    table: NDArray[Any],
    diagonal: bool,
    state: NDArray[Any],
    minima: NDArray[Any],
) -> None:
    # One sweep runs downwards, one upwards. They write their sums until they meet in the middle; then each adds to the
    # sums of the other. A sweep consists of bands of ``rows`` rows, cut into tiles of ``columns`` pixels that move back
    # a pixel with every row. A tile needs the tile before it, and the tiles of the band before up to the same place. So
    # bands run side by side, each a tile behind the one before.
    height, width = costs.shape[:2]
    rows, columns = _TILE if n_threads() > 3 else (height, height + width)
    middle = (height + 1) // 2
    n_bands = (middle + rows - 1) // rows
    for adds in (False, True):
        begun = ended = 0  # bands
        for turn in range(n_bands + (middle + width - 2) // columns):
            while ended < n_bands and (turn - ended) * columns >= (ended + 1) * rows + width - 1:
                ended += 1
            while begun < n_bands and (turn - begun + 1) * columns > begun * rows:
                begun += 1
            step = turn, ended, rows, columns
            run_bands(
                _sweep_tiles, 2 * (begun - ended), costs, total, edges, table, diagonal, adds, state, minima, step
            )


@jit
def _sweep_tiles(begin, end, costs, sums, edges, table, diagonal, adds, state, minima, step):
    # The tiles of one turn, in both sweeps: one tile of every band from ``first_band`` on.
    height = costs.shape[0]
    turn, first_band, rows, columns = step
    for task in range(begin, end):
        k, band = task % 2, first_band + task // 2
        meeting = height // 2 if k else (height + 1) // 2
        start, stop = (meeting, height) if adds else (0, meeting)
        first = start + band * rows
        tile = start + (turn - band) * columns
        _sweep(
            costs, sums, edges, table, diagonal, k == 1, adds, state[k], minima[k],
            first, min(first + rows, stop), tile, tile + columns,
        )  # fmt: skip


@helper
def _sweep(costs, sums, edges, table, diagonal, upwards, adds, state, minima, first, last, tile, tile_end):
    # Rows ``first`` to ``last`` of a sweep; in each, the columns ``tile`` to ``tile_end``, both minus the row. Sums are
    # written or, with ``adds``, added. Paths come from the left, above, upper left and upper right; upwards, from the
    # opposite directions. ``state`` contains the path costs, D + 2 cells per pixel: two pixels of the path along each
    # row; then, for each of the three directions from above, two alternating rows of W + 2 pixels. New paths begin at
    # margin pixels.
    height, width, n_disparities = costs.shape
    cells = n_disparities + 2
    step = -1 if upwards else 1
    to_next_row = step * width * n_disparities
    for row in range(first, last):
        y = height - 1 - row if upwards else row
        edge_row = y + 1 if upwards else y  # the row of ``edges`` towards the previous row
        odd = row & 1
        old, new = 2 * height + odd * 3 * (width + 2), 2 * height + (1 - odd) * 3 * (width + 2)
        for column in range(max(tile - row, 0), min(tile_end - row, width)):
            x = width - 1 - column if upwards else column
            at = (y * width + x) * n_disparities
            for i in range(0, n_disparities, 64):  # the pixel's cache lines in the next row
                prefetch(costs, at + to_next_row + i)
            for i in range(0, n_disparities, 32):
                prefetch(sums, at + to_next_row + i)
            back, front = 2 * row + (column & 1), 2 * row + 1 - (column & 1)
            above_old, above_new = old + width + 2 + x + 1, new + width + 2 + x + 1
            e = f = 0
            if column > 0:
                e = edges[0, y, x + 1] if upwards else edges[0, y, x]
            if row > 0:
                f = edges[2, edge_row, x]
            if not diagonal:
                path_step(
                    costs, at, state, (back * cells, above_old * cells), (front * cells, above_new * cells),
                    minima, (back, above_old), (front, above_new),
                    (table[e, 0], table[f, 0]), (table[e, 1], table[f, 1]), sums, at, adds, n_disparities,
                )  # fmt: skip
                continue
            u, v = x - step, x + step
            left_old, left_new = old + u + 1, new + x + 1
            right_old, right_new = old + 2 * (width + 2) + v + 1, new + 2 * (width + 2) + x + 1
            g = h = 0
            if row > 0 and 0 <= u < width:
                g = edges[1, edge_row, u if upwards else x]
            if row > 0 and 0 <= v < width:
                h = edges[3, edge_row, v if upwards else x]
            path_step(
                costs, at, state,
                (back * cells, above_old * cells, left_old * cells, right_old * cells),
                (front * cells, above_new * cells, left_new * cells, right_new * cells),
                minima, (back, above_old, left_old, right_old), (front, above_new, left_new, right_new),
                (table[e, 0], table[f, 0], table[g, 0], table[h, 0]),
                (table[e, 1], table[f, 1], table[g, 1], table[h, 1]), sums, at, adds, n_disparities,
            )  # fmt: skip
