"""Planes through scattered samples with outliers: at every pixel, a plane through the nearest samples that agree."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.algorithms.plane_fitting.least_squares import plane_slopes
from depthcli.core.method import ConfigModel
from depthcli.kernels.jit import empty, helper, jit, run_bands

Pixels = tuple[NDArray[np.int32], NDArray[np.int32]]
"""Rows and columns of P pixels, (P,) each."""


@dataclass(frozen=True)
class Samples:
    """Values at M pixels of a map."""

    # (M,) int32
    rows: NDArray[np.int32]
    columns: NDArray[np.int32]
    values: NDArray[np.float32]  # (M,) float32

    @classmethod
    def of(cls, values: NDArray[np.float32]) -> Samples:
        """Return the samples at all finite pixels of an (H, W) float32 map."""
        rows, columns = (axis.astype(np.int32) for axis in np.nonzero(np.isfinite(values)))
        return cls(rows, columns, values[rows, columns])

    def chosen(self, keep: NDArray[np.bool_]) -> Samples:
        """Return the samples where ``keep`` (M,) is true."""
        return Samples(self.rows[keep], self.columns[keep], self.values[keep])

    def distance(self, shape: tuple[int, int]) -> NDArray[np.float32]:
        """Return the distance of every pixel of a map of ``shape`` (H, W) from the nearest sample, pixels."""
        blank = np.ones(shape, np.uint8)
        blank[self.rows, self.columns] = 0
        return np.asarray(cv2.distanceTransform(blank, cv2.DIST_L2, cv2.DIST_MASK_PRECISE), np.float32)

    def nearest(self, at: Pixels, count: int, shape: tuple[int, int], skip_own: bool = False) -> NDArray[np.int32]:
        """Return the (P, count) indices of the samples nearest to the pixels ``at`` of a map of ``shape``.

        The nearest is first; ties are in the order of the samples. If there are fewer samples, the last columns are -1.
        ``skip_own`` leaves out a sample at the pixel itself.
        """
        height, width = shape
        # Cells with about two samples each.
        side = max(1, int(np.sqrt(2.0 * height * width / max(1, self.rows.size))))
        across, down = -(-width // side), -(-height // side)
        cell = (self.rows // side).astype(np.int64) * across + self.columns // side
        order = np.argsort(cell, kind="stable").astype(np.int32)
        first = np.searchsorted(cell[order], np.arange(across * down + 1))
        nearest = np.full((at[0].size, count), -1, np.int32)
        grid = order, first, side, across, down
        run_bands(_nearest, len(nearest), self.rows[order], self.columns[order], *grid, *at, skip_own, nearest)
        return nearest


@dataclass(frozen=True)
class SamplePlanes:
    """Planes through samples, evaluated at P pixels; all (P,) float32."""

    values: NDArray[np.float32]  # in the unit of the samples; NaN if there is no sample
    # standard deviation of the values: deviations of the plane, and of the surface from the plane, in quadrature
    sigma: NDArray[np.float32]
    confidence: NDArray[np.float32]  # weighted share in [0, 1] of the neighboring samples that agree with the plane
    # weighted mean of the property ``to_average`` over the agreeing samples; 0 without such a property
    averaged: NDArray[np.float32]


class SamplePlaneFit(ConfigModel):
    """Fit a plane at a pixel to the nearest samples of similar color that agree with each other, by Tukey's biweight.

    The fit starts at the sample that agrees with samples of the largest total weight. Slopes have a Gaussian prior.
    """

    neighbors: int = Field(24, ge=3, le=64, description="number of nearest samples that a plane is fitted to")
    color_scale: float = Field(
        60.0, gt=0, description="color difference at which a sample's weight falls by exp(-1/2), grey levels"
    )
    slope: float = Field(
        0.8, ge=0, description="typical slope of surfaces: change of depth across the image's width, over the depth"
    )
    steps: int = Field(5, ge=1, le=50, description="number of reweighted least squares, each with a narrower gate")

    def __call__(
        self,
        samples: Samples,
        image: NDArray[np.uint8],
        noise: float,
        at: Pixels,
        skip_own: bool = False,
        to_average: NDArray[np.float32] | None = None,
    ) -> SamplePlanes:
        """Fit a plane at each of P pixels.

        Parameters
        ----------
        image : (H, W, 3) uint8
        noise : standard deviation of good samples, in the unit of their values
        skip_own : leave out a sample at the pixel itself
        to_average : property of the M samples for the means in ``averaged``
        """
        shape = image.shape[0], image.shape[1]
        nearest = samples.nearest(at, self.neighbors, shape, skip_own)
        values, sigma = (np.full(at[0].size, np.nan, np.float32) for _ in range(2))
        confidence, averaged = (np.zeros(at[0].size, np.float32) for _ in range(2))
        marks = np.zeros(samples.values.size, np.float32) if to_average is None else to_average
        color_rate, slope = 1.0 / (2.0 * self.color_scale**2), self.slope / shape[1]
        scales = (np.float32(max(noise, 1e-9)), np.float32(color_rate), np.float32(slope))
        given = (nearest, samples.rows, samples.columns, samples.values, image, *at, *scales, self.steps, marks)
        run_bands(_fit, len(values), *given, values, sigma, confidence, averaged)
        return SamplePlanes(values, sigma, confidence, averaged)


@jit
def _fit(
    begin,
    end,
    nearest,
    rows,
    columns,
    values,
    image,
    at_y,
    at_x,
    noise,
    color_rate,
    slope,
    steps,
    marks,
    out,
    sigma,
    share,
    mark,
):
    for p in range(begin, end):
        count = 0
        while count < nearest.shape[1] and nearest[p, count] >= 0:
            count += 1
        if count == 0:
            continue
        y, x = at_y[p], at_x[p]
        dx, dy = empty(count, np.float32), empty(count, np.float32)
        m = empty(count, np.float32)
        v, w = empty(count, np.float32), empty(count, np.float32)
        last = nearest[p, count - 1]
        reach = np.float32(max((rows[last] - y) ** 2 + (columns[last] - x) ** 2, 1))
        total = np.float32(0.0)
        for k in range(count):
            s = nearest[p, k]
            dx[k], dy[k] = np.float32(columns[s] - x), np.float32(rows[s] - y)
            v[k] = values[s]
            m[k] = marks[s]
            color = np.float32(0.0)
            for c in range(3):
                step = np.float32(image[rows[s], columns[s], c]) - np.float32(image[y, x, c])
                color += step * step
            far = dx[k] * dx[k] + dy[k] * dy[k]
            w[k] = np.exp(-np.float32(2.0) * far / reach - color * color_rate) + np.float32(1e-12)
            total += w[k]
        start, steep = _start(dx, dy, v, w, noise, slope)
        out[p], sigma[p], share[p], mark[p] = _plane(dx, dy, v, w, m, total, noise, steep, start, steps)


@helper
def _start(dx, dy, v, w, noise, slope):
    # Return the value of the sample that the largest weight agrees with, and the standard deviation of slopes there.
    best = np.float32(-1.0)
    start = v[0]
    two = np.float32(2.0)
    for i in range(v.size):
        votes = np.float32(0.0)
        steep = slope * v[i]
        for j in range(v.size):
            far = np.sqrt((dx[i] - dx[j]) ** 2 + (dy[i] - dy[j]) ** 2)
            if abs(v[j] - v[i]) <= two * noise + steep * far:
                votes += w[j]
        if votes > best:
            best, start = votes, v[i]
    return start, slope * start


@helper
def _plane(dx, dy, v, w, m, total, noise, steep, start, steps):
    # Return the value at the pixel, its standard deviation, the weighted share of inliers and their mean mark.
    a, b, c = start, np.float32(0.0), np.float32(0.0)
    variance = np.float32(1.0)
    # Gaussian prior of slopes, in units of one sample's noise.
    prior = (noise / max(steep, np.float32(1e-12))) ** 2
    for step in range(steps):
        gate = noise * np.float32(6.0 - 3.0 * step / max(1, steps - 1))
        m00 = m01 = m02 = m12 = r0 = r1 = r2 = np.float32(0.0)
        m11 = m22 = np.float32(0.0)
        for k in range(v.size):
            wide = gate + (steep * np.sqrt(dx[k] * dx[k] + dy[k] * dy[k]) if step == 0 else np.float32(0.0))
            u = (v[k] - a - b * dx[k] - c * dy[k]) / wide
            if u * u >= 1:
                continue
            f = w[k] * (1 - u * u) ** 2
            m00 += f
            m01 += f * dx[k]
            m02 += f * dy[k]
            m11 += f * dx[k] * dx[k]
            m12 += f * dx[k] * dy[k]
            m22 += f * dy[k] * dy[k]
            r0 += f * (v[k] - a)
            r1 += f * (v[k] - a) * dx[k]
            r2 += f * (v[k] - a) * dy[k]
        if m00 <= np.float32(1e-9) * total:
            break
        m01, m02, m12 = m01 / m00, m02 / m00, m12 / m00
        m11, m22 = (m11 + prior) / m00, (m22 + prior) / m00
        r0, r1, r2 = r0 / m00, r1 / m00, r2 / m00
        p11, p12, p22 = m11 - m01 * m01, m12 - m01 * m02, m22 - m02 * m02
        q1, q2 = r1 - m01 * r0, r2 - m02 * r0
        determinant = p11 * p22 - p12 * p12
        b, c = plane_slopes(p11, p12, p22, q1, q2, determinant)
        a += r0 - b * m01 - c * m02
        variance = (1 + (p22 * m01 * m01 - 2 * p12 * m01 * m02 + p11 * m02 * m02) / determinant) / m00
    inside = np.float32(1e-12)
    away = marked = np.float32(0.0)
    for k in range(v.size):
        if abs(v[k] - a - b * dx[k] - c * dy[k]) <= np.float32(3.0) * noise:
            inside += w[k]
            away += w[k] * np.sqrt(dx[k] * dx[k] + dy[k] * dy[k])
            marked += w[k] * m[k]
    off = steep * away / inside
    return a, np.sqrt(noise * noise * variance + off * off), inside / total, marked / inside


@jit
def _nearest(begin, end, rows, columns, order, first, side, across, down, at_rows, at_columns, skip_own, nearest):
    count = nearest.shape[1]
    for p in range(begin, end):
        y, x = at_rows[p], at_columns[p]
        cy, cx = y // side, x // side
        best = np.full(count, np.int64(1) << np.int64(62), np.int64)
        have = 0
        ring = 0
        while ring <= max(across, down):
            for v in range(max(0, cy - ring), min(down, cy + ring + 1)):
                step = 1 if abs(v - cy) == ring else max(1, 2 * ring)
                for u in range(cx - ring, cx + ring + 1, step):
                    if u < 0 or u >= across:
                        continue
                    for s in range(first[v * across + u], first[v * across + u + 1]):
                        dy, dx = np.int64(rows[s] - y), np.int64(columns[s] - x)
                        far = dy * dy + dx * dx
                        if skip_own and far == 0:
                            continue
                        # Distance and index in one number, so that the order of ties is defined.
                        have = _insert(best, have, (far << np.int64(31)) | np.int64(order[s]))
            # Samples in further rings are at least this far away.
            reach = np.int64(
                ring * side
                + min(min(y - cy * side, cy * side + side - 1 - y), min(x - cx * side, cx * side + side - 1 - x))
                + 1
            )
            if have == count and (best[count - 1] >> np.int64(31)) < reach * reach:
                break
            ring += 1
        for k in range(have):
            nearest[p, k] = np.int32(best[k] & np.int64(0x7FFFFFFF))


@helper
def _insert(best, have, key):
    count = best.size
    if have == count and key >= best[count - 1]:
        return have
    at = min(have, count - 1)
    while at > 0 and best[at - 1] > key:
        best[at] = best[at - 1]
        at -= 1
    best[at] = key
    return min(have + 1, count)
