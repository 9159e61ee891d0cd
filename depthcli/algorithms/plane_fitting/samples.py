"""Values at scattered pixels, and the nearest of them to any pixel."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.kernels.jit import jit, parallel_jit, prange


@dataclass(frozen=True)
class Samples:
    """Values at M pixels of a map.

    Attributes
    ----------
    rows, columns : (M,) int32
    values : (M,) float32
    """

    rows: NDArray[np.int32]
    columns: NDArray[np.int32]
    values: NDArray[np.float32]

    @classmethod
    def of(cls, values: NDArray[np.float32]) -> Samples:
        """Return the samples at all finite pixels of an (H, W) float32 map."""
        rows, columns = (axis.astype(np.int32) for axis in np.nonzero(np.isfinite(values)))
        return cls(rows, columns, values[rows, columns])

    def chosen(self, keep: NDArray[np.bool_]) -> Samples:
        """Return the samples where ``keep`` (M,) is true."""
        return Samples(self.rows[keep], self.columns[keep], self.values[keep])

    def distance(self, shape: tuple[int, int]) -> NDArray[np.float32]:
        """Return, for a map of ``shape`` (H, W), the distance of every pixel from the nearest sample, pixels."""
        blank = np.ones(shape, np.uint8)
        blank[self.rows, self.columns] = 0
        return np.asarray(cv2.distanceTransform(blank, cv2.DIST_L2, cv2.DIST_MASK_PRECISE), np.float32)

    def nearest(
        self,
        at: tuple[NDArray[np.int32], NDArray[np.int32]],
        count: int,
        shape: tuple[int, int],
        skip_own: bool = False,
    ) -> NDArray[np.int32]:  # fmt: skip
        """Return the indices of the K samples nearest to each pixel, nearest first; ties in the order of the samples.

        Parameters
        ----------
        at : (P,) int32 rows and columns of the pixels
        count : number K of samples per pixel
        shape : (H, W) of the map
        skip_own : leave out a sample that lies on the pixel itself

        Returns
        -------
        (P, K) int32; -1 in the last columns where there are fewer than K samples
        """
        height, width = shape
        # Cells that hold about two samples each.
        side = max(1, int(np.sqrt(2.0 * height * width / max(1, self.rows.size))))
        across, down = -(-width // side), -(-height // side)
        cell = (self.rows // side).astype(np.int64) * across + self.columns // side
        order = np.argsort(cell, kind="stable").astype(np.int32)
        first = np.searchsorted(cell[order], np.arange(across * down + 1))
        nearest = np.full((at[0].size, count), -1, np.int32)
        _nearest(
            self.rows[order], self.columns[order], order, first, side, across, down, at[0], at[1], skip_own, nearest
        )
        return nearest


@parallel_jit
def _nearest(rows, columns, order, first, side, across, down, at_rows, at_columns, skip_own, nearest):
    count = nearest.shape[1]
    for p in prange(at_rows.size):
        y, x = at_rows[p], at_columns[p]
        cy, cx = y // side, x // side
        best = np.full(count, np.int64(1) << np.int64(62), np.int64)
        have = 0
        ring = 0
        while ring <= max(across, down):
            for v in range(max(0, cy - ring), min(down, cy + ring + 1)):
                step = 1 if abs(v - cy) == ring else max(1, 2 * ring)
                for u in range(cx - ring, cx + ring + 1, step):
                    if u < 0 or u >= across:
                        continue
                    for s in range(first[v * across + u], first[v * across + u + 1]):
                        dy, dx = np.int64(rows[s] - y), np.int64(columns[s] - x)
                        far = dy * dy + dx * dx
                        if skip_own and far == 0:
                            continue
                        # Distance and index in one number, so that ties have an order.
                        have = _insert(best, have, (far << np.int64(31)) | np.int64(order[s]))
            # Whatever lies in a further ring is at least this far away.
            reach = np.int64(ring * side + min(min(y - cy * side, cy * side + side - 1 - y),
                                               min(x - cx * side, cx * side + side - 1 - x)) + 1)  # fmt: skip
            if have == count and (best[count - 1] >> np.int64(31)) < reach * reach:
                break
            ring += 1
        for k in range(have):
            nearest[p, k] = np.int32(best[k] & np.int64(0x7FFFFFFF))


@jit
def _insert(best, have, key):
    count = best.size
    if have == count and key >= best[count - 1]:
        return have
    at = min(have, count - 1)
    while at > 0 and best[at - 1] > key:
        best[at] = best[at - 1]
        at -= 1
    best[at] = key
    return min(have + 1, count)
