"""Winner-takes-all disparities of both views from the costs of tiles."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.kernels.jit import parallel_jit, prange


class TiledWinners:
    """Winner-takes-all over an image whose costs are computed tile by tile, each tile with its own disparities.

    Parameters
    ----------
    shape : (H, W)
    minima : whether to compute the minima of parabolas, too

    Attributes
    ----------
    left : (H, W) uint16, the left view's winners; 0 where a tile has no disparity inside the right image
    minima : (H, W) float32, minima of the parabolas through each winner's cost and its two neighbors; or (0, 0)
    """

    def __init__(self, shape: tuple[int, int], minima: bool) -> None:
        self.left: NDArray[np.uint16] = np.zeros(shape, np.uint16)
        self.minima: NDArray[np.float32] = np.zeros(shape if minima else (0, 0), np.float32)
        # Smallest costs of the right view so far, columns mirrored: cost and disparity in one key, or apart.
        self._keys: NDArray[np.uint32] = np.zeros((0, 0), np.uint32)
        self._min_costs: NDArray[np.float32] = np.zeros((0, 0), np.float32)
        self._right: NDArray[np.uint16] | None = None

    def add(
        self, costs: NDArray[Any], spans: NDArray[np.int64], corner: tuple[int, int], inside: tuple[slice, slice]
    ) -> None:
        """Take the costs of a tile into account.

        Parameters
        ----------
        costs : (h, w, K), of one dtype and scale for all tiles
        spans : (n, 3) int64: first cell, number of cells and first disparity of runs of disparities, ascending
        corner : (y, x) of the tile in the image
        inside : rows and columns of the tile that count; every pixel of the image counts in one tile
        """
        bounds = (inside[0].start, inside[0].stop, inside[1].start, inside[1].stop)
        if self._keys.size == 0:
            self._keys = np.full(self.left.shape, 0xFFFFFFFF, np.uint32)
        if costs.dtype == np.float32:
            if self._min_costs.size == 0:
                self._min_costs = np.full(self.left.shape, np.inf, np.float32)
            _add_floats(costs, spans, corner, bounds, self.left, self._min_costs, self._keys)
        else:
            _add_integers(costs, spans, corner, bounds, self.left, self._keys)
        if self.minima.size:
            _add_minima(costs, spans, corner, bounds, self.left, self.minima)

    def right(self) -> NDArray[np.uint16]:
        """Return the (H, W) uint16 winners of the right view, and free memory: no tile can be added afterwards."""
        if self._right is None:
            self._right = np.empty(self.left.shape, np.uint16)
            _unmirror(self._keys, self._right)
            self._keys, self._min_costs = np.zeros((0, 0), np.uint32), np.zeros((0, 0), np.float32)
        return self._right


@parallel_jit
def _add_integers(costs, spans, corner, bounds, left, right):
    width = left.shape[1]
    for v in prange(bounds[0], bounds[1]):
        y = corner[0] + v
        for u in range(bounds[2], bounds[3]):
            x = corner[1] + u
            best = np.uint32(0xFFFFFFFF)
            for k in range(spans.shape[0]):
                start, low = spans[k, 0], spans[k, 2]
                count = min(spans[k, 1], x - low + 1)
                if count <= 0:
                    break
                row = costs[v, u, start : start + count]
                first = width - 1 - x + low
                mirror = right[y, first : first + count]
                d0 = np.uint32(low)
                for i in range(row.size):
                    key = np.uint32((np.uint32(row[i]) << np.uint32(16)) | np.uint32(np.uint32(i) + d0))
                    best = min(best, key)
                    mirror[i] = min(mirror[i], key)
            if best != np.uint32(0xFFFFFFFF):
                left[y, x] = np.uint16(best & np.uint32(0xFFFF))


@parallel_jit
def _add_floats(costs, spans, corner, bounds, left, min_costs, right):
    width = left.shape[1]
    for v in prange(bounds[0], bounds[1]):
        y = corner[0] + v
        for u in range(bounds[2], bounds[3]):
            x = corner[1] + u
            best = np.float32(np.inf)
            for k in range(spans.shape[0]):
                start, low = spans[k, 0], spans[k, 2]
                for i in range(min(spans[k, 1], x - low + 1)):
                    cost, d = costs[v, u, start + i], np.uint32(low + i)
                    if cost < best:
                        best = cost
                        left[y, x] = d
                    mirror = width - 1 - x + low + i
                    if cost < min_costs[y, mirror] or (cost == min_costs[y, mirror] and d < right[y, mirror]):
                        min_costs[y, mirror] = cost
                        right[y, mirror] = d


@parallel_jit
def _add_minima(costs, spans, corner, bounds, left, minima):
    for v in prange(bounds[0], bounds[1]):
        y = corner[0] + v
        for u in range(bounds[2], bounds[3]):
            x = corner[1] + u
            d = int(left[y, x])
            minima[y, x] = np.float32(d)
            for k in range(spans.shape[0]):
                n = d - spans[k, 2]
                if n < 1 or n + 1 >= min(spans[k, 1], x - spans[k, 2] + 1):
                    continue
                i = spans[k, 0] + n
                below, here, above = float(costs[v, u, i - 1]), float(costs[v, u, i]), float(costs[v, u, i + 1])
                curvature = below + above - 2.0 * here
                if below >= here and above >= here and curvature > 0.0:
                    minima[y, x] = np.float32(d + 0.5 * (below - above) / curvature)


@parallel_jit
def _unmirror(keys, out):
    height, width = out.shape
    for y in prange(height):
        for x in range(width):
            out[y, x] = np.uint16(keys[y, width - 1 - x] & np.uint32(0xFFFF))
