"""Slopes of a disparity map: those of a plane through the surrounding pixels that belong to the same surface."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.plane_fitting.least_squares import biweight_root, plane_slopes
from depthcli.kernels.jit import jit, parallel_jit, prange

BLOCK = 64
"""Number of pixels of a row that kernels process together; widths of their arrays are multiples of it."""

# Values of the preset stereo accurate, not varied by any script; the device kernels (slanted.cl) have the same.
_RIDGE = np.float32(0.2)  # square pixels added to the variance of positions
_COLOR_THRESHOLD = np.float32(75.0)  # sum over the channels of the differences, grey levels
_MIN_SAMPLES = np.float32(6.0)
_MAX_SLOPE = np.float32(1.0)  # pixels of disparity per pixel
_NOISE_VARIANCE = np.float32(0.01)  # square pixels, added to that of the residuals
_SHRINKAGE = np.float32(4.0)  # variances of a slope that count as much as its square
_STEPS = 4  # samples from the center of the window to its side


def framed(array: NDArray[Any], margin: int, value: float = 0) -> NDArray[Any]:
    """Return (..., H, W) padded with ``value``: by ``margin`` on all sides, and on the right up to a whole block."""
    *others, _, width = array.shape
    frame = [(0, 0)] * len(others) + [(margin, margin), (margin, margin + -width % BLOCK)]
    return np.pad(array, frame, constant_values=value)


def color_planes(image: NDArray[np.uint8], margin: int) -> NDArray[np.uint8]:
    """Return the channels of an (H, W, 3) uint8 image, one after another, padded as by :func:`framed`; uint8."""
    return framed(np.ascontiguousarray(image.transpose(2, 0, 1)), margin)


def slopes(values: NDArray[np.float32], image: NDArray[np.uint8], radius: int = 16) -> NDArray[np.float32]:
    """Compute the change of disparity from a pixel to the next one in its row and in its column.

    A plane is fitted by least squares to those of 9 x 9 samples of the window whose color is similar to the pixel's
    (differences of the channels sum to at most 75) and whose disparity is close (difference at most 1 + 0.15 distance).
    It is fitted once more to the samples within one pixel of disparity of it, with weights ``1 - residual^2``. Slopes
    that noise can explain are reduced: a slope g is multiplied by ``g^2 / (g^2 + 4 (variance + 0.01) / spread)``, with
    the variance of the residuals and the spread ``radius^2 / 3`` of positions in the window.

    Parameters
    ----------
    values : (H, W) float32 disparities, pixels, NaN = no value
    image : (H, W, 3) uint8
    radius : half side of the window, at least 4 pixels

    Returns
    -------
    (2, H, W) float32
        Along the row and along the column, within -1 .. 1; 0 where fewer than 6 pixels agree, or without a value.
    """
    height, width = values.shape
    result = np.zeros((2, height, width + -width % BLOCK), np.float32)
    step, limits, spread = window_sampling(radius)
    reach = _STEPS * step
    offsets = np.arange(-reach, reach + 1, step)
    grid = np.stack(np.meshgrid(offsets, offsets, indexing="ij"), axis=-1).reshape(-1, 2).astype(np.int64)
    known = framed(np.nan_to_num(values), reach)
    valid = framed((~np.isnan(values)).astype(np.float32), reach)
    _fit(known, valid, color_planes(image, reach), grid, limits.ravel(), reach, spread, result)
    return np.ascontiguousarray(result[:, :, :width])


def window_sampling(radius: int) -> tuple[int, NDArray[np.float32], np.float32]:
    """Return how the window of :func:`slopes` is sampled; the kernels of devices use the same numbers.

    Returns
    -------
    step : distance of neighboring samples, pixels
    limits : (9, 9) float32, the largest difference of disparity from the center, by the sample's row and column
    inverse_spread : one over the spread of positions in the window, 1 / square pixels
    """
    step = max(1, radius // _STEPS)
    offsets = np.arange(-_STEPS, _STEPS + 1) * step
    distance = np.sqrt((offsets[:, None] ** 2 + offsets[None, :] ** 2).astype(np.float64)).astype(np.float32)
    limits = (1.0 + np.float64(np.float32(0.15)) * distance.astype(np.float64)).astype(np.float32)  # rounded once
    return step, limits, np.float32(3.0 / radius**2)


@parallel_jit
def _fit(values, valid, planes, grid, limits, margin, spread, result):  # type: ignore[no-untyped-def]
    # Weights and differences of all samples first (SIMD over the block), then one sum after another.
    _, height, width = result.shape
    count = grid.shape[0]
    for y in prange(height):
        near = np.empty((count, BLOCK), np.float32)
        apart = np.empty((count, BLOCK), np.float32)
        weights = np.empty((count, BLOCK), np.float32)
        sums = np.empty((9, BLOCK), np.float32)
        slope_x = np.empty(BLOCK, np.float32)
        slope_y = np.empty(BLOCK, np.float32)
        offset = np.empty(BLOCK, np.float32)
        for x in range(0, width, BLOCK):
            first = x + margin
            _near_samples(values, valid, planes, grid, limits, y + margin, first, near, apart)
            _sum_moments(near, apart, grid, sums)
            _solve(sums, slope_x, slope_y, offset)
            _reweight(near, apart, grid, slope_x, slope_y, offset, weights)
            _sum_moments(weights, apart, grid, sums)
            _solve(sums, slope_x, slope_y, offset)
            _residual_variance(weights, apart, grid, slope_x, slope_y, offset, sums)
            here = valid[y + margin, first : first + BLOCK]
            for i in range(BLOCK):
                steep = slope_x[i] * slope_x[i] + slope_y[i] * slope_y[i]
                uncertainty = _SHRINKAGE * spread * (sums[0, i] + _NOISE_VARIANCE)
                share = here[i] * steep / (steep + uncertainty)
                result[0, y, x + i] = slope_x[i] * share
                result[1, y, x + i] = slope_y[i] * share


@jit
def _near_samples(values, valid, planes, grid, limits, y, x, near, apart):  # type: ignore[no-untyped-def]
    red0, green0, blue0 = planes[0, y, x : x + BLOCK], planes[1, y, x : x + BLOCK], planes[2, y, x : x + BLOCK]
    value0 = values[y, x : x + BLOCK]
    for k in range(grid.shape[0]):
        v, u = y + grid[k, 0], x + grid[k, 1]
        red, green, blue = planes[0, v, u : u + BLOCK], planes[1, v, u : u + BLOCK], planes[2, v, u : u + BLOCK]
        value, known = values[v, u : u + BLOCK], valid[v, u : u + BLOCK]
        out, difference, limit = near[k], apart[k], limits[k]
        for i in range(BLOCK):
            difference[i] = value[i] - value0[i]
        for i in range(BLOCK):
            color = np.float32(
                np.int16(abs(np.int16(np.int16(red[i]) - np.int16(red0[i]))))
                + np.int16(abs(np.int16(np.int16(green[i]) - np.int16(green0[i]))))
                + np.int16(abs(np.int16(np.int16(blue[i]) - np.int16(blue0[i]))))
            )
            belongs = color <= _COLOR_THRESHOLD and abs(difference[i]) <= limit
            out[i] = known[i] if belongs else np.float32(0)


@jit
def _reweight(near, apart, grid, slope_x, slope_y, offset, weights):  # type: ignore[no-untyped-def]
    for k in range(grid.shape[0]):
        dy, dx = np.float32(grid[k, 0]), np.float32(grid[k, 1])
        source, difference, out = near[k], apart[k], weights[k]
        for i in range(BLOCK):
            out[i] = source[i] * biweight_root(difference[i] - offset[i] - slope_x[i] * dx - slope_y[i] * dy)


@jit
def _sum_moments(weights, apart, grid, sums):  # type: ignore[no-untyped-def]
    sums[:] = 0
    for k in range(grid.shape[0]):
        dy, dx = np.float32(grid[k, 0]), np.float32(grid[k, 1])
        w, d = weights[k], apart[k]
        for n, factor in enumerate((np.float32(1), dx, dy, dx * dx, dx * dy, dy * dy)):
            total = sums[n]
            for i in range(BLOCK):
                total[i] += factor * w[i]
        for n, factor in enumerate((np.float32(1), dx, dy)):
            total = sums[6 + n]
            for i in range(BLOCK):
                total[i] += factor * w[i] * d[i]


@jit
def _residual_variance(weights, apart, grid, slope_x, slope_y, offset, sums):  # type: ignore[no-untyped-def]
    # The weighted mean of the squared residuals, into the first row of ``sums``.
    squares, total = sums[0], sums[1]
    squares[:] = 0
    total[:] = 0
    for k in range(grid.shape[0]):
        dy, dx = np.float32(grid[k, 0]), np.float32(grid[k, 1])
        w, difference = weights[k], apart[k]
        for i in range(BLOCK):
            residual = difference[i] - offset[i] - slope_x[i] * dx - slope_y[i] * dy
            squares[i] += w[i] * residual * residual
        for i in range(BLOCK):
            total[i] += w[i]
    for i in range(BLOCK):
        squares[i] /= max(total[i], np.float32(1))


@jit
def _solve(sums, slope_x, slope_y, offset):  # type: ignore[no-untyped-def]
    one = np.float32(1)
    for i in range(BLOCK):
        s = sums[0, i]
        sparse = s < _MIN_SAMPLES
        scale = one if sparse else one / s
        mx, my, md = sums[1, i] * scale, sums[2, i] * scale, sums[6, i] * scale
        xx = sums[3, i] * scale - mx * mx + _RIDGE
        xy = sums[4, i] * scale - mx * my
        yy = sums[5, i] * scale - my * my + _RIDGE
        xd = sums[7, i] * scale - mx * md
        yd = sums[8, i] * scale - my * md
        a, b = plane_slopes(xx, xy, yy, xd, yd, xx * yy - xy * xy)
        a = min(max(a, -_MAX_SLOPE), _MAX_SLOPE)
        b = min(max(b, -_MAX_SLOPE), _MAX_SLOPE)
        slope_x[i] = np.float32(0) if sparse else a
        slope_y[i] = np.float32(0) if sparse else b
        offset[i] = np.float32(0) if sparse else md - a * mx - b * my
