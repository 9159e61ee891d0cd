"""Planes through scattered samples with outliers: at every pixel, a plane through the nearest samples that agree."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from pydantic import Field

from depthcli.algorithms.nearest import nearest_points
from depthcli.algorithms.plane_fitting.least_squares import plane_slopes
from depthcli.core.maps import Floats, Image8, Ints, Mask
from depthcli.core.method import ConfigModel
from depthcli.kernels.jit import empty, helper, jit, run_bands

Pixels = tuple[Ints, Ints]
"""Rows and columns of P pixels, (P,) each."""


@dataclass(frozen=True)
class Samples:
    """Values at M pixels of a map."""

    # (M,) int32
    rows: Ints
    columns: Ints
    values: Floats  # (M,) float32

    @classmethod
    def of(cls, values: Floats) -> Samples:
        """Return the samples at all finite pixels of an (H, W) float32 map."""
        rows, columns = (axis.astype(np.int32) for axis in np.nonzero(np.isfinite(values)))
        return cls(rows, columns, values[rows, columns])

    def chosen(self, keep: Mask) -> Samples:
        """Return the samples where ``keep`` (M,) is true."""
        return Samples(self.rows[keep], self.columns[keep], self.values[keep])

    def distance(self, shape: tuple[int, int]) -> Floats:
        """Return the distance of every pixel of a map of ``shape`` (H, W) from the nearest sample, pixels."""
        blank = np.ones(shape, np.uint8)
        blank[self.rows, self.columns] = 0
        return np.asarray(cv2.distanceTransform(blank, cv2.DIST_L2, cv2.DIST_MASK_PRECISE), np.float32)


@dataclass(frozen=True)
class SamplePlanes:
    """Planes through samples, evaluated at P pixels; all (P,) float32."""

    values: Floats  # in the unit of the samples; NaN if there is no sample
    # standard deviation of the values: deviations of the plane, and of the surface from the plane, in quadrature
    sigma: Floats
    confidence: Floats  # weighted share in [0, 1] of the neighboring samples that agree with the plane
    # weighted mean of the property ``to_average`` over the agreeing samples; 0 without such a property
    averaged: Floats


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
        image: Image8,
        noise: float,
        at: Pixels,
        skip_own: bool = False,
        to_average: Floats | None = None,
    ) -> SamplePlanes:
        """Fit a plane at each of P pixels.

        Parameters
        ----------
        image : (H, W, 3) uint8
        noise : standard deviation of good samples, in the unit of their values
        skip_own : leave out a sample at the pixel itself
        to_average : property of the M samples for the means in ``averaged``
        """
        nearest = nearest_points(at[1], at[0], samples.columns, samples.rows, self.neighbors, skip_own)
        values, sigma = (np.full(at[0].size, np.nan, np.float32) for _ in range(2))
        confidence, averaged = (np.zeros(at[0].size, np.float32) for _ in range(2))
        marks = np.zeros(samples.values.size, np.float32) if to_average is None else to_average
        color_rate, slope = 1.0 / (2.0 * self.color_scale**2), self.slope / image.shape[1]
        scales = (np.float32(max(noise, 1e-9)), np.float32(color_rate), np.float32(slope))
        given = (nearest, samples.rows, samples.columns, samples.values, image, *at, *scales, self.steps, marks)
        run_bands(_fit, len(values), *given, values, sigma, confidence, averaged)
        return SamplePlanes(values, sigma, confidence, averaged)


@jit
def _fit(
    begin, end, nearest, rows, columns, values, image, at_y, at_x, noise, color_rate, slope, steps, marks,
    out, sigma, share, mark,
):  # fmt: skip
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
