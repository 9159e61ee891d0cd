"""Segments without a model join a neighbor that has one: region merging, continued with what is known of the scene."""

from __future__ import annotations

import heapq
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.kernels.jit import jit
from depthcli.methods.kinect.surfaces import Surfaces, surface_at

IMPOSSIBLE = 1000.0  # above any path of colors, so that a surface too near is taken only where there is no other


def grow(
    labels: NDArray[np.int32],
    modelled: NDArray[np.bool_],
    surfaces: Surfaces,
    color: NDArray[np.uint8],
    limit: NDArray[np.float32],
) -> NDArray[np.int32]:
    """Index of the surface that every segment takes: its own, or that of the modelled segment it joins.

    Each segment without a model joins along the path through neighbors that costs least: a step costs the sum of
    the absolute differences of the mean colors, a little for a short common boundary, and very much where
    the surface would be nearer than the shadow in which the segment lies allows.

    Parameters
    ----------
    labels : (H, W) int32, 0 .. n - 1
    modelled : (n,) bool
    surfaces : of all segments
    color : (H, W, 3) uint8, in a space where distances are differences that people see (CIELAB)
    limit : (H, W) float32, largest possible disparity, inf where there is none

    Returns
    -------
    (n,) int32, -1 for segments that no model reaches
    """
    count = modelled.size
    owners = np.where(modelled, np.arange(count, dtype=np.int32), np.int32(-1))
    if modelled.all() or not modelled.any():
        return owners
    mean, middle, most = _statistics(labels, color, limit, count)
    starts, neighbors, boundary = _neighbors(labels, count)
    _join(
        owners, mean, middle, most, starts, neighbors, boundary,
        surfaces.coefficients, surfaces.center, surfaces.bounds, surfaces.unit,
    )  # fmt: skip
    return owners


@jit
def _statistics(labels, color, limit, count):  # type: ignore[no-untyped-def]
    """Mean color, center (y, x), and mean limit of every segment; inf where less than a third has a limit."""
    height, width = labels.shape
    sums = np.zeros((count, 8), np.int64)  # size, three colors, y, x, pixels with a limit
    limits = np.zeros(count, np.float64)
    for y in range(height):
        for x in range(width):
            s = labels[y, x]
            sums[s, 0] += 1
            for c in range(3):
                sums[s, 1 + c] += color[y, x, c]
            sums[s, 4] += y
            sums[s, 5] += x
            if limit[y, x] < np.inf:
                sums[s, 6] += 1
                limits[s] += limit[y, x]
    mean = np.empty((count, 3), np.float64)
    middle = np.empty((count, 2), np.float64)
    most = np.full(count, np.inf)
    for s in range(count):
        size = float(sums[s, 0])
        for c in range(3):
            mean[s, c] = sums[s, 1 + c] / size
        for c in range(2):
            middle[s, c] = sums[s, 4 + c] / size
        if 3 * sums[s, 6] > sums[s, 0]:
            most[s] = limits[s] / sums[s, 6]
    return mean, middle, most


@jit
def _neighbors(labels, count):  # type: ignore[no-untyped-def]
    """Segments that touch: the neighbors of s are ``neighbors[starts[s]:starts[s + 1]]``, with pixels in common."""
    height, width = labels.shape
    starts = np.zeros(count + 1, np.int64)
    for y in range(height):
        for x in range(width):
            s = labels[y, x]
            for step in range(2):
                y2, x2 = (y, x + 1) if step == 0 else (y + 1, x)
                if y2 < height and x2 < width and labels[y2, x2] != s:
                    starts[s + 1] += 1
                    starts[labels[y2, x2] + 1] += 1
    for s in range(count):
        starts[s + 1] += starts[s]
    raw = np.empty(starts[count], np.int32)
    free = starts[:count].copy()
    for y in range(height):
        for x in range(width):
            s = labels[y, x]
            for step in range(2):
                y2, x2 = (y, x + 1) if step == 0 else (y + 1, x)
                if y2 < height and x2 < width and labels[y2, x2] != s:
                    t = labels[y2, x2]
                    raw[free[s]] = t
                    free[s] += 1
                    raw[free[t]] = s
                    free[t] += 1
    # Each bucket, written over itself without repetitions.
    place = np.full(count, -1, np.int64)
    boundary = np.zeros(raw.size, np.int32)
    end = 0
    for s in range(count):
        first, last = starts[s], starts[s + 1]
        starts[s] = end
        for k in range(first, last):
            t = raw[k]
            if place[t] < starts[s]:
                place[t] = end
                raw[end] = t
                boundary[end] = 0
                end += 1
            boundary[place[t]] += 1
    starts[count] = end
    return starts, raw[:end], boundary[:end]


@jit
def _join(owners, mean, middle, most, starts, neighbors, boundary, coefficients, center, bounds, unit):  # type: ignore[no-untyped-def]
    waiting: Any = [(0.0, s, s) for s in range(owners.size) if owners[s] == s]
    heapq.heapify(waiting)
    modelled = owners >= 0
    while len(waiting) > 0:
        cost, s, owner = heapq.heappop(waiting)
        if not modelled[s]:
            if owners[s] >= 0:
                continue
            owners[s] = owner
        for k in range(starts[s], starts[s + 1]):
            t = neighbors[k]
            if owners[t] >= 0:
                continue
            step = 10 / np.sqrt(float(boundary[k]))
            for c in range(3):
                step += abs(mean[s, c] - mean[t, c])
            if surface_at(coefficients, center, bounds, unit, owner, middle[t, 0], middle[t, 1]) > most[t]:
                step += IMPOSSIBLE
            heapq.heappush(waiting, (cost + step, np.int64(t), owner))
