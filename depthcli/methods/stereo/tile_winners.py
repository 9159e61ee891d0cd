"""Winners of an image whose costs come tile by tile."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.kernels.jit import parallel_jit, prange


class TileWinners:
    """Winners of an image whose costs come tile by tile, each over disparities of its own.

    Parameters
    ----------
    shape : (H, W)
    minima : whether the winners are wanted to a fraction of a pixel, too

    Attributes
    ----------
    left : (H, W) uint16, the left view's winners; 0 where a tile has no disparity inside the right image
    minima : (H, W) float32, minima of the parabolas through the winners' costs and those beside; (0, 0) if not wanted
    """

    def __init__(self, shape: tuple[int, int], minima: bool) -> None:
        self.left: NDArray[np.uint16] = np.zeros(shape, np.uint16)
        self.minima: NDArray[np.float32] = np.zeros(shape if minima else (0, 0), np.float32)
        # What the right view has found so far, columns mirrored: cost and disparity in one key, or apart.
        self._keys: NDArray[np.uint32] = np.zeros((0, 0), np.uint32)
        self._least: NDArray[np.float32] = np.zeros((0, 0), np.float32)
        self._right: NDArray[np.uint16] | None = None

    def add(
        self, costs: NDArray[Any], spans: NDArray[np.int64], corner: tuple[int, int], inside: tuple[slice, slice]
    ) -> None:
        """Look at the costs of a tile.

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
            if self._least.size == 0:
                self._least = np.full(self.left.shape, np.inf, np.float32)
            _gather_floats(costs, spans, corner, bounds, self.left, self._least, self._keys)
        else:
            _gather_integers(costs, spans, corner, bounds, self.left, self._keys)
        if self.minima.size:
            _gather_minima(costs, spans, corner, bounds, self.left, self.minima)

    def right(self) -> NDArray[np.uint16]:
        """(H, W) winners of the right view over all tiles; then no more can be added: memory is given back."""
        if self._right is None:
            self._right = np.empty(self.left.shape, np.uint16)
            _unmirror(self._keys, self._right)
            self._keys, self._least = np.zeros((0, 0), np.uint32), np.zeros((0, 0), np.float32)
        return self._right


@parallel_jit
def _gather_integers(costs: Any, spans: Any, corner: Any, bounds: Any, left: Any, right: Any) -> None:
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
def _gather_floats(costs: Any, spans: Any, corner: Any, bounds: Any, left: Any, least: Any, right: Any) -> None:
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
                    if cost < least[y, mirror] or (cost == least[y, mirror] and d < right[y, mirror]):
                        least[y, mirror] = cost
                        right[y, mirror] = d


@parallel_jit
def _gather_minima(costs: Any, spans: Any, corner: Any, bounds: Any, left: Any, minima: Any) -> None:
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
def _unmirror(keys: Any, found: Any) -> None:
    height, width = found.shape
    for y in prange(height):
        for x in range(width):
            found[y, x] = np.uint16(keys[y, width - 1 - x] & np.uint32(0xFFFF))
