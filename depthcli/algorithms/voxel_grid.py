"""Many overlapping clouds of points as one, with at most one point a cell of a grid."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError

_BITS = 21  # of the number of a cell along one axis, three of which make a key of 64 bits
_MIN_MERGED = 1 << 20  # cells of clouds that wait for being merged: fewer merges, bounded memory


class VoxelGrid:
    """A cubic grid that clouds are added to; every cell holds the means of the points in it and of their colors.

    The result depends on the clouds and on their order alone. Memory is in proportion to the number of cells that hold
    a point.
    """

    def __init__(self, edge: float) -> None:
        """Make an empty grid with cells of ``edge``, in the unit of the points, above 0."""
        self._edge = edge
        self._origin: NDArray[np.int64] | None = None  # cell that the keys count from: near the first point
        self._keys = np.zeros(0, np.int64)
        self._sums = np.zeros((0, 7))  # place in the cell, color, number of points
        self._waiting: list[tuple[NDArray[np.int64], NDArray[np.float64]]] = []

    def add(self, points: NDArray[np.float64], color: NDArray[np.uint8]) -> None:
        """Add points (N, 3), finite, with colors (N, 3).

        Raises
        ------
        InputError
            A point is too far from the first one for cells of this edge; none of them is added then.
        """
        if not len(points):
            return
        cells = np.floor(points / self._edge)
        if not np.all(np.abs(cells) < 2.0**62):
            raise InputError("its points are not finite, or too far away")
        whole = cells.astype(np.int64)
        origin = whole[0] if self._origin is None else self._origin
        beyond = np.abs(whole - origin).max()
        if beyond >= 1 << (_BITS - 1):
            raise InputError(
                f"points are {beyond * self._edge:.4g} from the first one, at most {2 ** (_BITS - 1)} voxels may be"
            )
        self._origin = origin
        key = np.zeros(len(points), np.int64)
        for axis in range(3):
            key = (key << _BITS) | (whole[:, axis] - origin[axis] + (1 << (_BITS - 1)))
        values = np.hstack([points - cells * self._edge, color, np.ones((len(points), 1))])
        self._waiting.append(_summed(key, values))
        if sum(len(keys) for keys, _ in self._waiting) > max(_MIN_MERGED, len(self._keys)):
            self._merge()

    def points(self) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
        """Return the mean point (N, 3) and the mean color (N, 3) of every cell, in the order of x, y, z."""
        self._merge()
        if self._origin is None:
            return np.zeros((0, 3)), np.zeros((0, 3), np.uint8)
        mask, half = (1 << _BITS) - 1, 1 << (_BITS - 1)
        cells = (
            np.stack([(self._keys >> shift) & mask for shift in (2 * _BITS, _BITS, 0)], axis=1) - half + self._origin
        )
        means = self._sums[:, :6] / self._sums[:, 6:]
        return cells * self._edge + means[:, :3], np.rint(means[:, 3:]).astype(np.uint8)

    def _merge(self) -> None:
        if self._waiting:
            keys = np.concatenate([self._keys, *(each for each, _ in self._waiting)])
            sums = np.concatenate([self._sums, *(each for _, each in self._waiting)])
            self._keys, self._sums = _summed(keys, sums)
            self._waiting.clear()


def _summed(keys: NDArray[np.int64], values: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the keys, sorted, each once, and the sums of their rows, added in the order given."""
    order = np.argsort(keys, kind="stable")
    keys = keys[order]
    starts = np.flatnonzero(np.concatenate([[True], keys[1:] != keys[:-1]])) if len(keys) else np.zeros(0, np.int64)
    return keys[starts], np.add.reduceat(values[order], starts, axis=0) if len(keys) else values
