"""Slopes of a disparity map, from planes through surrounding pixels of the same surface."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.plane_fitting.least_squares import plane_slopes
from depthcli.core.maps import Floats, Image8
from depthcli.kernels.jit import empty, helper, jit, run_bands
from depthcli.kernels.lanes import (
    LANES,
    SHORT_LANES,
    absolute_difference,
    halves,
    load,
    load_shorts,
    maximum,
    minimum,
    splat,
    store,
    where_at_most,
)

# Values of the preset stereo accurate; no script varies them. The device kernels (slanted.cl) have the same values.
_RIDGE = np.float32(0.2)  # square pixels added to the variance of positions
_COLOR_THRESHOLD = np.float32(75.0)  # largest sum of the channels' differences, grey levels
_MIN_SAMPLES = np.float32(6.0)
_MAX_SLOPE = np.float32(1.0)  # pixels of disparity per pixel
_NOISE_VARIANCE = np.float32(0.01)  # added to the variance of the residuals, square pixels
_SHRINKAGE = np.float32(4.0)  # a slope whose square is this many variances is halved
_STEPS = 4  # samples from the center of the window to its side


def framed(array: NDArray[Any], margin: int) -> NDArray[Any]:
    """Return (..., H, W) padded with 0, by ``margin`` on all sides and to whole vectors on the right; NaN becomes 0."""
    *others, height, width = array.shape
    result = np.zeros((*others, height + 2 * margin, width + 2 * margin + -width % SHORT_LANES), array.dtype)
    inside = result[..., margin : margin + height, margin : margin + width]
    np.copyto(inside, array, where=array == array)
    return result


def color_planes(image: Image8, margin: int) -> Image8:
    """Return the channels of an (H, W, 3) uint8 image as planes, padded by :func:`framed`; uint8."""
    return framed(image.transpose(2, 0, 1), margin)


def slopes(values: Floats, image: Image8, radius: int = 16) -> Floats:
    """Compute the change of disparity from a pixel to the next one in its row and in its column.

    A plane is fitted by least squares to the samples, of 9 x 9 in the window, with a similar color (channel differences
    sum to at most 75) and a close disparity (difference at most 1 + 0.15 distance). It is fitted again to the samples
    within one pixel of disparity from it, with weights ``1 - residual^2``. Slopes that noise can explain are reduced: a
    slope g is multiplied by ``g^2 / (g^2 + 4 (variance + 0.01) / spread)``, with the variance of the residuals and the
    spread ``radius^2 / 3`` of positions in the window. ``radius`` is half the window's side, at least 4 pixels.

    Returns slopes along the row and along the column, (2, H, W) float32 within -1 .. 1; 0 if fewer than 6 samples
    agree, or if the value is NaN.
    """
    height, width = values.shape
    result = np.empty((2, height, width + -width % SHORT_LANES), np.float32)
    step, limits, spread = window_sampling(radius)
    reach = _STEPS * step
    valid = framed((~np.isnan(values)).astype(np.float32), reach)
    run_bands(_fit, height, framed(values, reach), valid, color_planes(image, reach), step, limits, spread, result)
    return np.ascontiguousarray(result[:, :, :width])


def window_sampling(radius: int) -> tuple[int, Floats, np.float32]:
    """Return the sampling of the window of :func:`slopes`; device kernels use the same numbers.

    These are the distance between neighboring samples in pixels, the largest disparity difference from the center for
    each sample (9, 9), and 1 / spread of positions in the window.
    """
    step = max(1, radius // _STEPS)
    offsets = np.arange(-_STEPS, _STEPS + 1) * step
    distance = np.sqrt((offsets[:, None] ** 2 + offsets[None, :] ** 2).astype(np.float64)).astype(np.float32)
    limits = (1.0 + np.float64(np.float32(0.15)) * distance.astype(np.float64)).astype(np.float32)  # rounded once
    return step, limits, np.float32(3.0 / radius**2)


@jit
def _fit(begin, end, values, valid, planes, step, limits, spread, result):
    # Store the differences and weights of all samples for a block of pixels, then fit planes to them.
    _, height, width = result.shape
    side = limits.shape[0]
    row_size = values.shape[1]
    plane_size = values.shape[0] * row_size
    margin = _STEPS * step
    zero, color_limit = splat(np.float32(0)), splat(_COLOR_THRESHOLD)
    for y in range(begin, end):
        apart = empty(side * side * SHORT_LANES, np.float32)
        weights = empty(side * side * SHORT_LANES, np.float32)
        for x in range(0, width, SHORT_LANES):
            center = (y + margin) * row_size + x + margin
            red, green = load_shorts(planes, center), load_shorts(planes, center + plane_size)
            blue = load_shorts(planes, center + 2 * plane_size)
            for i in range(side):
                for j in range(side):
                    there = (y + i * step) * row_size + x + j * step
                    color = color_differences(planes, there, plane_size, red, green, blue)
                    limit, at = splat(limits[i, j]), (i * side + j) * SHORT_LANES
                    for half in range(2):
                        shift = half * LANES
                        difference = load(values, there + shift) - load(values, center + shift)
                        weight = load(valid, there + shift)
                        weight = where_at_most(color[half], color_limit, weight, zero)
                        distance = maximum(difference, zero - difference)
                        store(apart, at + shift, difference)
                        store(weights, at + shift, where_at_most(distance, limit, weight, zero))
            for shift in range(0, SHORT_LANES, LANES):
                slope_x, slope_y, offset = _fitted(weights, apart, side, step, shift)
                _reweight(weights, apart, side, step, shift, slope_x, slope_y, offset)
                slope_x, slope_y, offset = _fitted(weights, apart, side, step, shift)
                variance = _residual_variance(weights, apart, side, step, shift, slope_x, slope_y, offset)
                steep = slope_x * slope_x + slope_y * slope_y
                uncertainty = splat(_SHRINKAGE * spread) * (variance + splat(_NOISE_VARIANCE))
                share = load(valid, center + shift) * steep / (steep + uncertainty)
                at = y * width + x + shift
                store(result, at, slope_x * share)
                store(result, at + height * width, slope_y * share)


@helper
def color_differences(colors: Any, at: int, plane_size: int, red: Any, green: Any, blue: Any) -> Any:
    """Return the sums of absolute channel differences of two runs of pixels, as two vectors of float32.

    One run of SHORT_LANES pixels begins at ``at`` in each plane of ``colors`` (see :func:`color_planes`); the colors of
    the other run are vectors of int16.
    """
    return halves(
        absolute_difference(load_shorts(colors, at), red)
        + absolute_difference(load_shorts(colors, at + plane_size), green)
        + absolute_difference(load_shorts(colors, at + 2 * plane_size), blue)
    )


@helper
def _fitted(weights, apart, side, step, shift):
    # Return slopes along the row and the column, and the offset at the center, of the planes through the samples.
    zero = splat(np.float32(0))
    s, sx, sy, sxx, sxy, syy, sd, sxd, syd = zero, zero, zero, zero, zero, zero, zero, zero, zero
    for i in range(side):
        row, row_x, row_xx, row_d, row_xd = zero, zero, zero, zero, zero
        for j in range(side):
            at = (i * side + j) * SHORT_LANES + shift
            dx = splat(np.float32((j - side // 2) * step))
            w = load(weights, at)
            wx, wd = w * dx, w * load(apart, at)
            row = row + w
            row_x = row_x + wx
            row_xx = row_xx + wx * dx
            row_d = row_d + wd
            row_xd = row_xd + wd * dx
        dy = splat(np.float32((i - side // 2) * step))
        down = dy * row
        s, sx, sy = s + row, sx + row_x, sy + down
        sxx, sxy, syy = sxx + row_xx, sxy + dy * row_x, syy + dy * down
        sd, sxd, syd = sd + row_d, sxd + row_xd, syd + dy * row_d
    min_samples, one = splat(_MIN_SAMPLES), splat(np.float32(1))
    scale = where_at_most(min_samples, s, one / maximum(s, min_samples), one)
    mx, my, md = sx * scale, sy * scale, sd * scale
    ridge = splat(_RIDGE)
    xx, xy, yy = sxx * scale - mx * mx + ridge, sxy * scale - mx * my, syy * scale - my * my + ridge
    a, b = plane_slopes(xx, xy, yy, sxd * scale - mx * md, syd * scale - my * md, xx * yy - xy * xy)
    steepest = splat(_MAX_SLOPE)
    a = minimum(maximum(a, zero - steepest), steepest)
    b = minimum(maximum(b, zero - steepest), steepest)
    offset = md - a * mx - b * my
    return (
        where_at_most(min_samples, s, a, zero),
        where_at_most(min_samples, s, b, zero),
        where_at_most(min_samples, s, offset, zero),
    )


@helper
def _residual(apart, at, i, j, side, step, slope_x, slope_y, offset):
    dy, dx = splat(np.float32((i - side // 2) * step)), splat(np.float32((j - side // 2) * step))
    return load(apart, at) - offset - slope_x * dx - slope_y * dy


@helper
def _reweight(weights, apart, side, step, shift, slope_x, slope_y, offset):
    one, zero = splat(np.float32(1)), splat(np.float32(0))
    for i in range(side):
        for j in range(side):
            at = (i * side + j) * SHORT_LANES + shift
            residual = _residual(apart, at, i, j, side, step, slope_x, slope_y, offset)
            store(weights, at, load(weights, at) * maximum(one - residual * residual, zero))


@helper
def _residual_variance(weights, apart, side, step, shift, slope_x, slope_y, offset):
    # Return the weighted mean of the squared residuals.
    one, total, squares = splat(np.float32(1)), splat(np.float32(0)), splat(np.float32(0))
    for i in range(side):
        for j in range(side):
            at = (i * side + j) * SHORT_LANES + shift
            residual = _residual(apart, at, i, j, side, step, slope_x, slope_y, offset)
            weight = load(weights, at)
            total, squares = total + weight, squares + weight * residual * residual
    return squares / maximum(total, one)
