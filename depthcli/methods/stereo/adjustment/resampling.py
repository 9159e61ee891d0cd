"""Correction of a right image: rows shifted by a polynomial, grey levels multiplied by gains."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from depthcli.core.frames import Image, StereoPair
from depthcli.kernels.jit import jit, parallel_jit, prange

CELL = 4  # side of the cells that have one gain, pixels of the reduced size
N_TERMS = 6  # of a polynomial of the second degree: the effect of small rotations and of different focal lengths
# Parts of the largest grey level at which samples begin to count as saturated, and over which that rises to 1.
_SATURATION_START, _SATURATION_RANGE = np.float32(0.92), np.float32(0.07)


@dataclass(frozen=True)
class Correction:
    """Geometric and radiometric correction of a right image.

    Attributes
    ----------
    row_shift : (6,) how far below its row in the left image a point lies in the right one, pixels of the reduced
        size: coefficients of 1, u, v, u u, u v, v v, for column u and row v from -1 to 1
    gains : (h, w, 3) float32 factors of cells of 4 x 4 pixels of the reduced size, or (1, 1, 3) of the whole image
    """

    row_shift: NDArray[np.float64]
    gains: NDArray[np.float32]

    def apply(self, pair: StereoPair, factor: int) -> StereoPair:
        """Return ``pair``, which is ``factor`` times the reduced size, with its right image corrected."""
        if not self.row_shift.any() and self.gains is IDENTITY.gains:
            return pair
        right = np.ascontiguousarray(pair.clamped[1]).reshape(*pair.shape, -1)
        out = np.empty_like(right)
        resample(right, self.row_shift * factor, self.gains, CELL * factor, np.float32(pair.top), out)
        return StereoPair(pair.left, cast(Image, out.reshape(pair.right.shape)), pair.bits)


IDENTITY = Correction(np.zeros(N_TERMS), np.ones((1, 1, 3), np.float32))
"""The correction that changes nothing."""


@jit
def polynomial(c, u, v):
    """Return the value at (u, v) of the polynomial with the 6 coefficients ``c``."""
    return c[0] + c[1] * u + c[2] * v + c[3] * u * u + c[4] * u * v + c[5] * v * v


@jit
def cubic(p0, p1, p2, p3, t):
    """Return the Catmull-Rom spline through four samples, between ``p1`` (t = 0) and ``p2`` (t = 1)."""
    half = np.float32(0.5)
    a = half * (p2 - p0)
    b = p0 - np.float32(2.5) * p1 + np.float32(2) * p2 - half * p3
    c = half * (p3 - p0) + np.float32(1.5) * (p1 - p2)
    return p1 + t * (a + t * (b + t * c))


@parallel_jit
def resample(image, row_shift, gains, cell, top, out):
    """Write (H, W, C) ``image`` with its rows shifted, times the bilinearly interpolated ``gains``, to ``out``.

    Gains below 1 rise to 1 towards the largest grey level ``top``: saturated samples times a gain that varies would
    seem to have a slope.
    """
    height, width, channels = image.shape
    grid_height, grid_width = gains.shape[:2]
    half = np.float32(0.5)
    kind = image.dtype.type
    for y in prange(height):
        gy = min(max((np.float32(y) + half) / np.float32(cell) - half, np.float32(0)), np.float32(grid_height - 1))
        i0 = int(gy)
        i1 = min(i0 + 1, grid_height - 1)
        ty = gy - np.float32(i0)
        down = (2.0 * y - height) / height
        for x in range(width):
            gx = min(max((np.float32(x) + half) / np.float32(cell) - half, np.float32(0)), np.float32(grid_width - 1))
            j0 = int(gx)
            j1 = min(j0 + 1, grid_width - 1)
            tx = gx - np.float32(j0)
            row = np.float32(float(y) + polynomial(row_shift, (2.0 * x - width) / width, down))
            v = int(np.floor(row))
            t = row - np.float32(v)
            v0, v1 = min(max(v - 1, 0), height - 1), min(max(v, 0), height - 1)
            v2, v3 = min(max(v + 1, 0), height - 1), min(max(v + 2, 0), height - 1)
            for c in range(channels):
                upper = gains[i0, j0, c] + tx * (gains[i0, j1, c] - gains[i0, j0, c])
                lower = gains[i1, j0, c] + tx * (gains[i1, j1, c] - gains[i1, j0, c])
                p0, p1 = np.float32(image[v0, x, c]), np.float32(image[v1, x, c])
                p2, p3 = np.float32(image[v2, x, c]), np.float32(image[v3, x, c])
                value = cubic(p0, p1, p2, p3, t)
                gain = upper + ty * (lower - upper)
                if gain < 1:
                    gain += (np.float32(1) - gain) * min(
                        max((value / top - _SATURATION_START) / _SATURATION_RANGE, np.float32(0)), np.float32(1)
                    )
                out[y, x, c] = kind(min(max(value * gain + half, np.float32(0)), top))
