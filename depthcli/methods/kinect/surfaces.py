"""Surfaces of segments: those that segments without a model join, and the detail that a smooth surface leaves out."""

from __future__ import annotations

import heapq
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.plane_fitting.polynomials import Surfaces, surface_at
from depthcli.algorithms.regions import adjacency, region_graph
from depthcli.kernels.jit import jit, parallel_jit, prange

SHADOW_PENALTY = 1000.0
"""Cost of a surface that a shadow rules out: above any path of colors, so that it is taken only without another."""
_BOUNDARY_COST = 10  # of a common boundary of one pixel, grey levels; value of the shipped presets, not varied


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
    ``SHADOW_PENALTY`` where the surface would be nearer than the shadow in which the segment lies allows.

    Parameters
    ----------
    labels : (H, W) int32, 0 .. n - 1
    modelled : (n,) bool
    surfaces : of all segments
    color : (H, W, 3) uint8 CIELAB
    limit : (H, W) float32, largest possible disparity, inf where there is none

    Returns
    -------
    (n,) int32 indices of surfaces, -1 for segments that no model reaches
    """
    count = modelled.size
    owners = np.where(modelled, np.arange(count, dtype=np.int32), np.int32(-1))
    if modelled.all() or not modelled.any():
        return owners
    graph = region_graph(labels, color)
    places = np.indices(labels.shape, np.float64).reshape(2, -1)
    centers = np.stack([np.bincount(labels.ravel(), axis, count) for axis in places], axis=1)
    limited = np.isfinite(limit)
    n_limited = np.bincount(labels[limited], minlength=count)
    mean_limit = np.bincount(labels[limited], limit[limited], count) / np.maximum(n_limited, 1)
    mean_limit[3 * n_limited <= graph.sizes] = np.inf  # too few pixels of the segment lie in a shadow
    _join(
        owners, graph.means, centers / graph.sizes[:, None], mean_limit,
        *adjacency(count, graph.edges, graph.boundary),
        surfaces.coefficients, surfaces.center, surfaces.bounds, surfaces.unit,
    )  # fmt: skip
    return owners


@jit
def _join(owners, mean, segment_center, limits, starts, neighbors, boundary, coefficients, center, bounds, unit):  # type: ignore[no-untyped-def]
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

    Parameters
    ----------
    surface, known : (H, W) float32, NaN = unknown
    labels : (H, W) int32
    scale : (n,) float32 of the residuals; those above three count as three
    reach : pixels
    """
    decay = np.float32(np.exp(-1 / reach))
    limit = np.float32(3) * scale[labels]
    residuals = np.clip(known - surface, -limit, limit)
    weights = (~np.isnan(residuals)).astype(np.float32)
    residuals[weights == 0] = 0
    _spread_along_rows(labels, decay, residuals, weights)
    residuals, weights = np.ascontiguousarray(residuals.T), np.ascontiguousarray(weights.T)
    _spread_along_rows(np.ascontiguousarray(labels.T), decay, residuals, weights)
    surface += (residuals / (weights + np.float32(0.5))).T


@parallel_jit
def _spread_along_rows(labels, decay, residuals, weights):  # type: ignore[no-untyped-def]
    # Recursive sums over the pixels of one segment, to the right and back.
    height, width = labels.shape
    back = np.float32(1) - decay * decay  # the way back adds to the sums of the way there
    for y in prange(height):
        for x in range(1, width):
            if labels[y, x - 1] == labels[y, x]:
                residuals[y, x] += decay * residuals[y, x - 1]
                weights[y, x] += decay * weights[y, x - 1]
        for x in range(width - 2, -1, -1):
            if labels[y, x + 1] == labels[y, x]:
                residuals[y, x] = back * residuals[y, x] + decay * residuals[y, x + 1]
                weights[y, x] = back * weights[y, x] + decay * weights[y, x + 1]
