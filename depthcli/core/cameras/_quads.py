"""Kernel that draws small quadrilaterals into a map of inverse depth."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from depthcli.kernels.jit import jit

_ON_EDGE = -1e-9  # share of a triangle: pixels on an edge belong to it in spite of rounding


@jit
def draw_quads(
    x: NDArray[np.float64], y: NDArray[np.float64], inverse: NDArray[np.float64], image: NDArray[np.float64]
) -> None:
    """Draw quadrilaterals as two triangles each; where several cover the center of a pixel, the nearest stays.

    Inside of a triangle, inverse depth is interpolated linearly, which is exact on planes. Of both diagonals, that with
    the more similar ends divides a quadrilateral. Triangles that are seen from behind are left out.

    Parameters
    ----------
    x, y : (N, 4) of the corners, pixels, clockwise as the image is seen
    inverse : (N, 4) inverse depth of the corners, above 0
    image : (H, W) inverse depth, 0 = nothing there yet; changed in place
    """
    for n in range(len(x)):
        other = int(abs(inverse[n, 0] - inverse[n, 2]) > abs(inverse[n, 1] - inverse[n, 3]))
        _draw_triangle(x[n], y[n], inverse[n], 0 + other, 1 + other, 2 + other, image)
        _draw_triangle(x[n], y[n], inverse[n], 2 + other, (3 + other) % 4, 0 + other, image)


@jit
def _draw_triangle(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    inverse: NDArray[np.float64],
    a: int,
    b: int,
    c: int,
    image: NDArray[np.float64],
) -> None:
    ux, uy, vx, vy = x[b] - x[a], y[b] - y[a], x[c] - x[a], y[c] - y[a]
    area = ux * vy - vx * uy
    if not area > 0:
        return
    height, width = image.shape
    top = max(math.ceil(min(y[a], y[b], y[c]) - 1e-6), 0)
    bottom = min(math.floor(max(y[a], y[b], y[c]) + 1e-6), height - 1)
    left = max(math.ceil(min(x[a], x[b], x[c]) - 1e-6), 0)
    right = min(math.floor(max(x[a], x[b], x[c]) + 1e-6), width - 1)
    for row in range(top, bottom + 1):
        for column in range(left, right + 1):
            dx, dy = column - x[a], row - y[a]
            share_b = (dx * vy - vx * dy) / area
            share_c = (ux * dy - dx * uy) / area
            if share_b < _ON_EDGE or share_c < _ON_EDGE or share_b + share_c > 1 - _ON_EDGE:
                continue
            value = inverse[a] + share_b * (inverse[b] - inverse[a]) + share_c * (inverse[c] - inverse[a])
            if value > image[row, column]:
                image[row, column] = value
