"""Surfaces of segments: those that segments without a model join, and the detail that a smooth surface leaves out."""

from __future__ import annotations

import heapq
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.plane_fitting.polynomials import Surfaces, surface_at
from depthcli.algorithms.regions import region_adjacency
from depthcli.kernels.jit import jit, parallel_jit, prange

SHADOW_PENALTY = 1000.0
"""Cost of a surface that a shadow rules out: above any path of colors, so that it is taken only without another."""
_BOUNDARY_COST = 10  # of a common boundary of one pixel, grey levels; value of the shipped presets, not varied
_COLUMNS = 64  # a task of the vertical pass: whole cache lines


def join_segments(
    labels: NDArray[np.int32],
    modelled: NDArray[np.bool_],
    surfaces: Surfaces,
    color: NDArray[np.uint8],
    limit: NDArray[np.float32],
) -> NDArray[np.int32]:
    """Assign a surface to every segment: its own, or that of the modelled segment that it joins.

    Each segment without a model joins along the path of least cost through neighbors. A step costs the sum of the
    absolute differences of the mean colors, 10 over the root of the length of the common boundary, and
    ``SHADOW_PENALTY`` where the surface would be nearer than ``limit``, that of the shadow in which the segment lies.

    Returns (n,) int32 indices of surfaces for the n segments; -1 where no model reaches.
    """
    count = modelled.size
    owners = np.where(modelled, np.arange(count, dtype=np.int32), np.int32(-1))
    if modelled.all() or not modelled.any():
        return owners
    mean, segment_center, limits = _statistics(labels, color, limit, count)
    starts, neighbors, boundary = region_adjacency(labels, count)
    shapes = (surfaces.coefficients, surfaces.center, surfaces.bounds, surfaces.unit)
    _join(owners, mean, segment_center, limits, starts, neighbors, boundary, *shapes)
    return owners


@jit
def _statistics(labels, color, limit, count):
    # Mean color, center (y, x), and mean limit of every segment; inf where at most a third has a limit.
    height, width = labels.shape
    sums = np.zeros((count, 8), np.int64)  # size, three colors, y, x, pixels with a limit
    limit_sums = np.zeros(count, np.float64)
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
                limit_sums[s] += limit[y, x]
    mean = np.empty((count, 3), np.float64)
    segment_center = np.empty((count, 2), np.float64)
    limits = np.full(count, np.inf)
    for s in range(count):
        size = float(sums[s, 0])
        for c in range(3):
            mean[s, c] = sums[s, 1 + c] / size
        for c in range(2):
            segment_center[s, c] = sums[s, 4 + c] / size
        if 3 * sums[s, 6] > sums[s, 0]:
            limits[s] = limit_sums[s] / sums[s, 6]
    return mean, segment_center, limits


@jit
def _join(owners, mean, segment_center, limits, starts, neighbors, boundary, coefficients, center, bounds, unit):
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
            step = _BOUNDARY_COST / np.sqrt(float(boundary[k]))
            for c in range(3):
                step += abs(mean[s, c] - mean[t, c])
            y, x = segment_center[t]
            if surface_at(coefficients, center, bounds, unit, owner, y, x) > limits[t]:
                step += SHADOW_PENALTY
            heapq.heappush(waiting, (cost + step, np.int64(t), owner))


def add_detail(
    surface: NDArray[np.float32],
    known: NDArray[np.float32],
    labels: NDArray[np.int32],
    scale: NDArray[np.float32],
    reach: float,
) -> None:
    """Add to ``surface``, in place, the smoothed residuals of the ``known`` values around in the same segment.

    The weight falls by e in ``reach`` pixels along a path within the segment, first along the row, then along the
    column. Far from all known pixels the surface stays as it is: a residual counts against half a pixel of zeros.
    Residuals above three of the segment's ``scale`` count as three.
    """
    weights, residuals = (np.empty(surface.shape, np.float32) for _ in range(2))
    decay = np.float32(np.exp(-1 / reach))
    _residuals(surface, known, labels, scale, decay, residuals, weights)
    _spread_down(labels, decay, residuals, weights)
    surface += residuals / (weights + np.float32(0.5))


@parallel_jit
def _residuals(surface, known, labels, scale, decay, residuals, weights):
    height, width = surface.shape
    back = np.float32(1) - decay * decay  # the second pass adds to the sums of the first
    for y in prange(height):
        for x in range(width):
            s = labels[y, x]
            residual = known[y, x] - surface[y, x]
            residuals[y, x] = np.float32(0)
            weights[y, x] = np.float32(0)
            if not np.isnan(residual):
                limit = np.float32(3) * scale[s]
                residuals[y, x] = min(max(residual, -limit), limit)
                weights[y, x] = np.float32(1)
            if x > 0 and labels[y, x - 1] == s:
                residuals[y, x] += decay * residuals[y, x - 1]
                weights[y, x] += decay * weights[y, x - 1]
        for x in range(width - 2, -1, -1):
            if labels[y, x + 1] == labels[y, x]:
                residuals[y, x] = back * residuals[y, x] + decay * residuals[y, x + 1]
                weights[y, x] = back * weights[y, x] + decay * weights[y, x + 1]


@parallel_jit
def _spread_down(labels, decay, residuals, weights):
    height, width = labels.shape
    back = np.float32(1) - decay * decay
    for task in prange((width + _COLUMNS - 1) // _COLUMNS):
        first = task * _COLUMNS
        end = min(first + _COLUMNS, width)
        for y in range(1, height):
            for x in range(first, end):
                if labels[y, x] == labels[y - 1, x]:
                    residuals[y, x] += decay * residuals[y - 1, x]
                    weights[y, x] += decay * weights[y - 1, x]
        for y in range(height - 2, -1, -1):
            for x in range(first, end):
                if labels[y, x] == labels[y + 1, x]:
                    residuals[y, x] = back * residuals[y, x] + decay * residuals[y + 1, x]
                    weights[y, x] = back * weights[y, x] + decay * weights[y + 1, x]
