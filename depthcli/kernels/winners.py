"""Winner-takes-all disparities of both views from one cost volume, and the left-right difference."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.kernels.jit import helper, jit, run_bands, zeros


def winners(
    costs: NDArray[Any], minima: NDArray[np.float32] | None = None
) -> tuple[NDArray[np.uint16], NDArray[np.uint16]]:
    """Return the disparities of the smallest costs of the left and of the right view.

    The right view's costs are the left view's costs along diagonals, ``c_R(x, d) = c(x + d, d)``. Disparities that lead
    outside the other image are left out. Among equal costs, the smaller disparity wins.

    Parameters
    ----------
    costs : (H, W, D) uint8, uint16 or float32
    minima : (H, W) float32 output: the left view's disparities refined by :func:`parabola_minimum`; None: not needed

    Returns
    -------
    left, right : (H, W) uint16, pixels
    """
    left = np.empty(costs.shape[:2], np.uint16)
    right = np.empty(costs.shape[:2], np.uint16)
    refined = np.empty((0, 0), np.float32) if minima is None else minima  # one type: compiled once
    kernel = _float_winners if costs.dtype == np.float32 else _integer_winners
    run_bands(kernel, len(costs), costs, left, right, refined)
    return left, right


@jit
def _integer_winners(begin, end, costs, left, right, minima):
    # Cost and disparity share one 32-bit key, so that a single minimum finds both.
    _, width, n_disparities = costs.shape
    for y in range(begin, end):
        best_right = np.full(width + n_disparities, 0xFFFFFFFF, np.uint32)
        for x in range(width):
            count = min(n_disparities, x + 1)
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
        if minima.size:
            _integer_minima(costs[y], left[y], minima[y])


@helper
def _integer_minima(costs, left, minima):
    # Write parabola_minimum of a row's winners, in a form that compiles to vector code.
    width, n_disparities = costs.shape
    around = zeros((3, width), np.int32)
    for x in range(width):
        d = np.int64(left[x])
        if 1 <= d < min(n_disparities, x + 1) - 1:
            around[0, x], around[1, x], around[2, x] = costs[x, d - 1], costs[x, d], costs[x, d + 1]
    below, lowest, above = around[0], around[1], around[2]
    for x in range(width):
        curvature = below[x] + above[x] - 2 * lowest[x]
        shift = 0.5 * np.float64(below[x] - above[x]) / np.float64(max(curvature, 1))
        minima[x] = np.float32(np.float64(left[x]) + shift) if curvature > 0 else np.float32(left[x])


@jit
def _float_winners(begin, end, costs, left, right, minima):
    _, width, n_disparities = costs.shape
    for y in range(begin, end):
        best_right = np.full(width, np.inf, np.float32)
        for x in range(width):
            best = np.float32(np.inf)
            winner = 0
            for d in range(min(n_disparities, x + 1)):
                cost = costs[y, x, d]
                if cost < best:
                    best = cost
                    winner = d
                if cost < best_right[x - d]:
                    best_right[x - d] = cost
                    right[y, x - d] = d
            left[y, x] = winner
            if minima.size:
                minima[y, x] = parabola_minimum(costs[y, x, : min(n_disparities, x + 1)], winner)


@helper
def parabola_minimum(costs, d):
    """Return the minimum of the parabola through ``costs[d]`` and its two neighbors; ``d`` if ``d`` is no minimum.

    ``costs`` (K,) contain no disparities that lead outside the other image.
    """
    if 1 <= d < costs.size - 1:
        below, lowest, above = float(costs[d - 1]), float(costs[d]), float(costs[d + 1])
        curvature = below + above - 2.0 * lowest
        if below >= lowest and above >= lowest and curvature > 0.0:
            return np.float32(d + 0.5 * (below - above) / curvature)
    return np.float32(d)


def right_at_match(values: NDArray[np.float32], right: NDArray[Any]) -> NDArray[np.float32]:
    """Return the right view's disparity at the match of every pixel, (H, W) float32; inf outside the right image.

    Parameters
    ----------
    values : (H, W) disparities of the left view, pixels, at least 0, no NaN
    right : (H, W) disparities of the right view, pixels
    """
    column = np.arange(values.shape[1]) - np.rint(values).astype(np.intp)
    match = np.take_along_axis(right, np.maximum(column, 0), axis=1).astype(np.float32)
    match[column < 0] = np.inf
    return match


def left_right_difference(left: NDArray[Any], right: NDArray[Any]) -> NDArray[np.float32]:
    """Return ``|d - d_R|`` for every pixel: the difference from the right view's disparity at its match.

    Parameters
    ----------
    left, right : (H, W) disparities of the two views, pixels, no NaN

    Returns
    -------
    (H, W) float32, pixels; inf if the match is outside the right image
    """
    match = np.arange(left.shape[1]) - (left + np.float32(0.5)).astype(np.intp)
    partner = np.take_along_axis(right, np.maximum(match, 0), axis=1)
    difference = np.abs(left.astype(np.float32) - partner.astype(np.float32))
    difference[match < 0] = np.inf
    return difference
