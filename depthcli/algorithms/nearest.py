"""The points of a plane that are nearest to given places, in a defined order."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.core.maps import Ints
from depthcli.kernels.jit import helper, jit, run_bands


def nearest_points(
    center_x: NDArray[Any], center_y: NDArray[Any], x: NDArray[Any], y: NDArray[Any], count: int, skip_own: bool = False
) -> Ints:
    """Return the (N, count) int32 indices of the (M,) points nearest to each of (N,) centers, the nearest first.

    Among equally distant points, the earlier one is first. If there are fewer points, the last columns are -1.
    ``skip_own`` leaves out points at the center itself. Coordinates are in pixels.
    """
    nearest = np.full((len(center_x), count), -1, np.int32)
    if nearest.size and len(x):
        center_x, center_y, x, y = (np.asarray(values, np.float64) for values in (center_x, center_y, x, y))
        # Square cells with about two points each; whole pixels are in their middle.
        left, top = np.floor(x.min()) - 0.5, np.floor(y.min()) - 0.5
        side = max(1.0, np.floor(np.sqrt(2.0 * (x.max() - left) * (y.max() - top) / len(x))))
        across, down = int((x.max() - left) // side) + 1, int((y.max() - top) // side) + 1
        cell = ((y - top) // side).astype(np.int64) * across + ((x - left) // side).astype(np.int64)
        order = np.argsort(cell, kind="stable")
        first = np.searchsorted(cell[order], np.arange(across * down + 1))
        grid = left, top, side, across, down
        run_bands(_nearest, len(nearest), x[order], y[order], order, first, grid, center_x, center_y, skip_own, nearest)
    return nearest


@jit
def _nearest(begin, end, x, y, name, first, grid, center_x, center_y, skip_own, nearest):
    # Rings of cells around the center's cell. The points of cell k are first[k] .. first[k + 1] - 1.
    left, top, side, across, down = grid
    for n in range(begin, end):
        cx, cy = center_x[n] - left, center_y[n] - top
        u0, v0 = int(np.floor(cx / side)), int(np.floor(cy / side))
        to_border = min(min(cx - u0 * side, (u0 + 1) * side - cx), min(cy - v0 * side, (v0 + 1) * side - cy))
        distances, count = np.full(nearest.shape[1], np.inf), 0
        for ring in range(max(max(u0, across - 1 - u0), max(v0, down - 1 - v0)) + 1):
            for v in range(max(0, v0 - ring), min(down, v0 + ring + 1)):
                step = 1 if abs(v - v0) == ring else max(1, 2 * ring)
                for u in range(u0 - ring, u0 + ring + 1, step):
                    if u < 0 or u >= across:
                        continue
                    for s in range(first[v * across + u], first[v * across + u + 1]):
                        squared = (x[s] - center_x[n]) ** 2 + (y[s] - center_y[n]) ** 2
                        if not (skip_own and squared == 0.0):
                            count = _insert(distances, nearest[n], count, squared, name[s])
            reach = ring * side + to_border - 1e-6  # points in further rings are farther away
            if count == distances.size and reach > 0 and distances[count - 1] < reach * reach:
                break


@helper
def _insert(distances, nearest, count, squared, name):
    # Insert a point into the lists of the nearest points so far; return their number.
    last = distances.size - 1
    if squared > distances[last] or (squared == distances[last] and name > nearest[last]):
        return count
    at = min(count, last)
    while at > 0 and (squared < distances[at - 1] or (squared == distances[at - 1] and name < nearest[at - 1])):
        distances[at], nearest[at] = distances[at - 1], nearest[at - 1]
        at -= 1
    distances[at], nearest[at] = squared, name
    return min(count + 1, last + 1)
