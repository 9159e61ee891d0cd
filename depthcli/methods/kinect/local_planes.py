"""Planes through the neighborhood of every pixel: what a surface looks like beside and beyond it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.kernels.jit import jit, parallel_jit, prange

REACH = 4  # the windows are 9 x 9
_GATE = 4.0  # residuals beyond so many times the noise count nothing
_FIRST_GATE = 6.4, 1.0  # before there is a plane: this, and more by so much a pixel of distance
_RIDGE = 1.0  # square pixels added to the scatter: thin support must not yield steep planes
_STEEPEST = 0.7  # pixels of disparity a pixel
_PIECE = 64  # pixels of a row that are worked on together
_LEAST_SUPPORT = 8.0  # with less weight than this the plane is level


@dataclass(frozen=True)
class LocalPlanes:
    """A plane for every pixel; all (H, W) float32.

    Attributes
    ----------
    value : disparity of the plane at the pixel, pixels; NaN where there was none
    slope_x, slope_y : pixels of disparity a pixel, to the right and downwards
    scale : root of the mean weighted squared residual, pixels
    """

    value: NDArray[np.float32]
    slope_x: NDArray[np.float32]
    slope_y: NDArray[np.float32]
    scale: NDArray[np.float32]

    def every(self, stride: int) -> LocalPlanes:
        """The planes of every n-th pixel of every n-th row, with slopes by such steps."""
        part, steps = np.s_[::stride, ::stride], np.float32(stride)
        return LocalPlanes(self.value[part], self.slope_x[part] * steps, self.slope_y[part] * steps, self.scale[part])


def local_planes(
    disparity: NDArray[np.float32],
    trust: NDArray[np.float32],
    noise: float,
    before: LocalPlanes | None = None,
    changed: NDArray[np.bool_] | None = None,
) -> LocalPlanes:
    """Robust planes by reweighted least squares with Tukey's biweight, from three reweightings.

    Parameters
    ----------
    disparity : (H, W) float32, pixels, NaN = unknown
    trust : (H, W) float32 >= 0, weight of every pixel; unknown ones count nothing
    noise : of the disparity, pixels
    before, changed : planes of a map that had other values or weights at the pixels (H, W) bool ``changed`` alone:
        planes that these do not touch are taken over
    """
    known = ~np.isnan(disparity)
    padded = np.zeros((disparity.shape[0] + 2 * REACH, disparity.shape[1] + 2 * REACH), np.float32)
    weight = np.zeros_like(padded)
    inner = np.s_[REACH:-REACH, REACH:-REACH]
    padded[inner] = np.where(known, disparity, 0)
    weight[inner] = np.where(known, trust, 0)
    if before is None or changed is None:
        changed = np.ones(disparity.shape, bool)
        planes = LocalPlanes(*(np.empty(disparity.shape, np.float32) for _ in range(4)))
    else:
        planes = LocalPlanes(before.value.copy(), before.slope_x.copy(), before.slope_y.copy(), before.scale.copy())
    side = 2 * REACH + 1
    touched = cv2.dilate(changed.astype(np.uint8), np.ones((side, side), np.uint8))
    first, growth, last = (np.float32(g * noise) for g in (*_FIRST_GATE, _GATE))
    _fit(padded, weight, touched, first, growth, last, planes.value, planes.slope_x, planes.slope_y, planes.scale)
    planes.value[~known] = np.nan
    return planes


@parallel_jit
def _fit(disparity, trust, touched, first_gate, growth, gate, value, slope_x, slope_y, scale):  # type: ignore[no-untyped-def]
    """Rows side by side, in pieces; within a piece all pixels at once, one offset of the window after the other."""
    height, width = value.shape
    for y in prange(height):
        sums = np.empty((10, _PIECE), np.float32)
        for left in range(0, width, _PIECE):
            right = min(left + _PIECE, width)
            if touched[y, left:right].any():
                _fit_piece(
                    disparity, trust, y, left, right - left, first_gate, growth, gate, sums,
                    value[y, left:right], slope_x[y, left:right], slope_y[y, left:right], scale[y, left:right],
                )  # fmt: skip


@jit
def _fit_piece(  # type: ignore[no-untyped-def]
    disparity, trust, y, left, width, first_gate, growth, gate, sums, value, slope_x, slope_y, scale,
):  # fmt: skip
    one, zero = np.float32(1), np.float32(0)
    s, sx, sy, sd, sxx = sums[0, :width], sums[1, :width], sums[2, :width], sums[3, :width], sums[4, :width]
    sxy, syy, sxd, syd, sdd = sums[5, :width], sums[6, :width], sums[7, :width], sums[8, :width], sums[9, :width]
    own = disparity[y + REACH, left + REACH : left + REACH + width]
    a, b, c = slope_x, slope_y, value
    for i in range(width):
        a[i] = zero
        b[i] = zero
        c[i] = zero
    for step in range(3):
        sums[:] = zero
        for dy in range(-REACH, REACH + 1):
            for dx in range(-REACH, REACH + 1):
                first = left + REACH + dx
                d = disparity[y + REACH + dy, first : first + width]
                t = trust[y + REACH + dy, first : first + width]
                fx, fy = np.float32(dx), np.float32(dy)
                inverse = one / (first_gate + growth * max(abs(fx), abs(fy)) if step == 0 else gate)
                for i in range(width):
                    v = d[i] - own[i]
                    r = (v - (a[i] * fx + b[i] * fy + c[i])) * inverse
                    w = max(zero, one - r * r)
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
            determinant = max(xx * yy - xy * xy, np.float32(1e-6))
            enough = one if total >= np.float32(_LEAST_SUPPORT) else zero
            steepest = np.float32(_STEEPEST) * enough
            a[i] = min(max((xd * yy - yd * xy) / determinant, -steepest), steepest)
            b[i] = min(max((yd * xx - xd * xy) / determinant, -steepest), steepest)
            c[i] = md - a[i] * mx - b[i] * my
    for i in range(width):
        total = max(s[i], np.float32(1e-6))
        # sum of squared residuals of the last weights about the plane they gave
        square = sdd[i] + a[i] * a[i] * sxx[i] + b[i] * b[i] * syy[i] + c[i] * c[i] * s[i]
        square -= np.float32(2) * (a[i] * sxd[i] + b[i] * syd[i] + c[i] * sd[i])
        square += np.float32(2) * (a[i] * b[i] * sxy[i] + a[i] * c[i] * sx[i] + b[i] * c[i] * sy[i])
        scale[i] = np.sqrt(max(square, zero) / total)
        c[i] += own[i]
