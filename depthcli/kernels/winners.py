"""Winner-takes-all: the cheapest disparity of every pixel, for both views, from one volume; do they agree?"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.kernels.jit import jit, parallel_jit, prange


def winners(costs: NDArray[Any]) -> tuple[NDArray[np.uint16], NDArray[np.uint16]]:
    """Cheapest disparities of the left and of the right view.

    The right view's costs are the left's read along diagonals, ``c_R(x, d) = c(x + d, d)``. Cells outside
    the other image take no part; the smaller disparity wins ties.

    Parameters
    ----------
    costs : (H, W, D) uint8, uint16 or float32

    Returns
    -------
    left, right : (H, W) uint16, pixels
    """
    left = np.empty(costs.shape[:2], np.uint16)
    right = np.empty(costs.shape[:2], np.uint16)
    if costs.dtype == np.float32:
        _float_winners(costs, left, right)
    else:
        _integer_winners(costs, left, right)
    return left, right


@parallel_jit
def _integer_winners(costs: Any, left: Any, right: Any) -> None:
    # Cost and disparity share one 32-bit key, so that a plain minimum finds both.
    height, width, depth = costs.shape
    for y in prange(height):
        best_right = np.full(width + depth, 0xFFFFFFFF, np.uint32)
        for x in range(width):
            count = min(depth, x + 1)
            row = costs[y, x, :count]
            mirror = best_right[width - 1 - x : width - 1 - x + count]
            best = np.uint32(0xFFFFFFFF)
            for i in range(row.size):
                key = np.uint32((np.uint32(row[i]) << np.uint32(16)) | np.uint32(i))
                best = min(best, key)
                mirror[i] = min(mirror[i], key)
            left[y, x] = np.uint16(best & np.uint32(0xFFFF))
        for x in range(width):
            right[y, x] = np.uint16(best_right[width - 1 - x] & np.uint32(0xFFFF))


@parallel_jit
def _float_winners(costs: Any, left: Any, right: Any) -> None:
    height, width, depth = costs.shape
    for y in prange(height):
        best_right = np.full(width, np.inf, np.float32)
        for x in range(width):
            best = np.float32(np.inf)
            winner = 0
            for d in range(min(depth, x + 1)):
                cost = costs[y, x, d]
                if cost < best:
                    best = cost
                    winner = d
                if cost < best_right[x - d]:
                    best_right[x - d] = cost
                    right[y, x - d] = d
            left[y, x] = winner


@jit
def partner_difference(disparity: Any, x: int, right: Any) -> Any:
    """``|d - d_R|`` at the match of a pixel in column x, its row of the right map given; inf outside the image."""
    u = x - int(disparity + np.float32(0.5))
    return abs(np.float32(disparity) - np.float32(right[u])) if u >= 0 else np.float32(np.inf)


def left_right_difference(left: NDArray[Any], right: NDArray[Any]) -> NDArray[np.float32]:
    """How far the right view's disparity at a pixel's match is from the pixel's own.

    Parameters
    ----------
    left, right : (H, W) disparities of the two views, pixels, no NaN

    Returns
    -------
    (H, W) float32, pixels; inf where the match lies outside the right image
    """
    difference = np.empty(left.shape, np.float32)
    _left_right_difference(left, right, difference)
    return difference


@parallel_jit
def _left_right_difference(left: Any, right: Any, difference: Any) -> None:
    height, width = left.shape
    for y in prange(height):
        for x in range(width):
            difference[y, x] = partner_difference(left[y, x], x, right[y])


class Gathered:
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
