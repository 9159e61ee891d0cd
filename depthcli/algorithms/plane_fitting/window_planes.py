"""Planes through the 9 x 9 window of every pixel."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from depthcli.algorithms.plane_fitting.least_squares import biweight_root, plane_slopes
from depthcli.core.maps import Floats, Mask
from depthcli.kernels.jit import empty, helper, jit, run_bands

RADIUS = 4
"""Half side of the windows, pixels."""

# Values of the published preset refine-kinect accurate; nothing in the repository varies them.
_GATE = 4.0  # larger residuals have no weight, multiples of the noise
_FIRST_GATE, _FIRST_GATE_GROWTH = 6.4, 1.0  # first fit: gate, and its growth per pixel of distance
_RIDGE = 1.0  # added to the scatter, square pixels: thin support must not yield steep planes
_MAX_SLOPE = 0.7  # pixels of disparity per pixel
_MIN_SUPPORT = 8.0  # with a smaller sum of weights the plane is level
_BLOCK = 64  # pixels of a row that are fitted together: a few vectors, with all sums in the cache


class WindowPlanes(NamedTuple):
    """A plane for every pixel; all (H, W) float32."""

    value: Floats  # disparity of the plane at the pixel, pixels; NaN if the disparity is unknown
    # pixels of disparity per pixel, to the right and downwards
    slope_x: Floats
    slope_y: Floats
    scale: Floats  # root of the mean weighted squared residual, pixels

    def every(self, stride: int) -> WindowPlanes:
        """Return the planes of every n-th pixel of every n-th row, n = ``stride``; slopes are per n pixels."""
        value, slope_x, slope_y, scale = (np.ascontiguousarray(each[::stride, ::stride]) for each in self)
        return WindowPlanes(value, slope_x * np.float32(stride), slope_y * np.float32(stride), scale)


def window_planes(
    disparity: Floats,
    trust: Floats,
    noise: float,
    previous: WindowPlanes | None = None,
    changed: Mask | None = None,
) -> WindowPlanes:
    """Fit a plane to the window of every pixel, by three reweighted least squares with Tukey's biweight.

    ``trust`` are the weights of the pixels; ``noise`` is the standard deviation of the disparity, pixels. With the
    ``previous`` planes of an earlier map, only planes whose windows contain a pixel with ``changed`` disparity or trust
    are fitted again.
    """
    known = ~np.isnan(disparity)
    padded = np.pad(np.where(known, disparity, np.float32(0)), RADIUS)
    weight = np.pad(np.where(known, trust, np.float32(0)), RADIUS)
    if previous is None or changed is None:
        changed = np.ones(disparity.shape, bool)
        planes = WindowPlanes(*(np.empty(disparity.shape, np.float32) for _ in range(4)))
    else:
        planes = WindowPlanes(*(each.copy() for each in previous))
    side = 2 * RADIUS + 1
    affected = cv2.dilate(changed.astype(np.uint8), np.ones((side, side), np.uint8))
    first, growth, gate = (np.float32(g * noise) for g in (_FIRST_GATE, _FIRST_GATE_GROWTH, _GATE))
    run_bands(_fit, len(disparity), padded, weight, affected, first, growth, gate, *planes)
    planes.value[~known] = np.nan
    return planes


@jit
def _fit(begin, end, disparity, trust, affected, first_gate, growth, gate, value, slope_x, slope_y, scale):
    # Rows are fitted in blocks: all pixels of a block at once, one offset of the window after another.
    width = value.shape[1]
    for y in range(begin, end):
        sums = empty((10, _BLOCK), np.float32)
        for left in range(0, width, _BLOCK):
            right = min(left + _BLOCK, width)
            if affected[y, left:right].any():
                _fit_block(
                    disparity, trust, y, left, right - left, first_gate, growth, gate, sums,
                    value[y, left:right], slope_x[y, left:right], slope_y[y, left:right], scale[y, left:right],
                )  # fmt: skip


@helper
def _fit_block(disparity, trust, y, left, width, first_gate, growth, gate, sums, value, slope_x, slope_y, scale):
    one, zero = np.float32(1), np.float32(0)
    s, sx, sy, sd, sxx = sums[0, :width], sums[1, :width], sums[2, :width], sums[3, :width], sums[4, :width]
    sxy, syy, sxd, syd, sdd = sums[5, :width], sums[6, :width], sums[7, :width], sums[8, :width], sums[9, :width]
    own = disparity[y + RADIUS, left + RADIUS : left + RADIUS + width]
    a, b, c = slope_x, slope_y, value
    for i in range(width):
        a[i] = zero
        b[i] = zero
        c[i] = zero
    for step in range(3):
        sums[:] = zero
        for dy in range(-RADIUS, RADIUS + 1):
            for dx in range(-RADIUS, RADIUS + 1):
                first = left + RADIUS + dx
                d = disparity[y + RADIUS + dy, first : first + width]
                t = trust[y + RADIUS + dy, first : first + width]
                fx, fy = np.float32(dx), np.float32(dy)
                inverse = one / (first_gate + growth * max(abs(fx), abs(fy)) if step == 0 else gate)
                for i in range(width):
                    v = d[i] - own[i]
                    w = biweight_root((v - (a[i] * fx + b[i] * fy + c[i])) * inverse)
                    w = t[i] * w * w
                    s[i] += w
                    sx[i] += w * fx
                    sy[i] += w * fy
                    sd[i] += w * v
                    sxx[i] += w * fx * fx
                    sxy[i] += w * fx * fy
                    syy[i] += w * fy * fy
                    sxd[i] += w * fx * v
                    syd[i] += w * fy * v
                    sdd[i] += w * v * v
        for i in range(width):
            total = max(s[i], np.float32(1e-6))
            mx, my, md = sx[i] / total, sy[i] / total, sd[i] / total
            xx = sxx[i] - total * mx * mx + np.float32(_RIDGE)
            yy = syy[i] - total * my * my + np.float32(_RIDGE)
            xy = sxy[i] - total * mx * my
            xd = sxd[i] - total * mx * md
            yd = syd[i] - total * my * md
            across, down = plane_slopes(xx, xy, yy, xd, yd, max(xx * yy - xy * xy, np.float32(1e-6)))
            max_slope = np.float32(_MAX_SLOPE) * (one if total >= np.float32(_MIN_SUPPORT) else zero)
            a[i] = min(max(across, -max_slope), max_slope)
            b[i] = min(max(down, -max_slope), max_slope)
            c[i] = md - a[i] * mx - b[i] * my
    for i in range(width):
        total = max(s[i], np.float32(1e-6))
        # Sum of squared residuals about the final plane, with the last weights.
        square = sdd[i] + a[i] * a[i] * sxx[i] + b[i] * b[i] * syy[i] + c[i] * c[i] * s[i]
        square -= np.float32(2) * (a[i] * sxd[i] + b[i] * syd[i] + c[i] * sd[i])
        square += np.float32(2) * (a[i] * b[i] * sxy[i] + a[i] * c[i] * sx[i] + b[i] * c[i] * sy[i])
        scale[i] = np.sqrt(max(square, zero) / total)
        c[i] += own[i]
