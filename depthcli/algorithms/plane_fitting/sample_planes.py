"""Planes through scattered, partly wrong samples: at every pixel, through those nearest samples that agree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from depthcli.algorithms.plane_fitting.least_squares import plane_slopes
from depthcli.algorithms.plane_fitting.samples import Samples
from depthcli.kernels.jit import jit, parallel_jit, prange


@dataclass(frozen=True)
class SamplePlanes:
    """Planes through samples, evaluated at P pixels; all (P,) float32.

    Attributes
    ----------
    values : in the unit of the samples; NaN where there is no sample
    sigma : standard deviation of the values: that of the plane at the pixel together with that of the surface from it
    confidence : weighted share in [0, 1] of the neighboring samples that lie on the plane
    averaged : weighted mean over these samples of the property that was given to be averaged; else 0
    """

    values: NDArray[np.float32]
    sigma: NDArray[np.float32]
    confidence: NDArray[np.float32]
    averaged: NDArray[np.float32]


class SamplePlaneFit(BaseModel):
    """Fit a plane at a pixel to the nearest samples of similar color that agree with each other, by Tukey's biweight.

    The fit starts at the sample with which samples of the largest total weight agree; slopes have a Gaussian prior.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

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
        at: tuple[NDArray[np.int32], NDArray[np.int32]],
        skip_own: bool = False,
        to_average: NDArray[np.float32] | None = None,
    ) -> SamplePlanes:
        """Fit a plane at each of P pixels.

        Parameters
        ----------
        samples : M samples
        image : (H, W, 3) uint8
        noise : standard deviation of good samples, in the unit of their values
        at : (P,) int32 rows and columns of the pixels
        skip_own : leave out a sample on the pixel itself
        to_average : (M,) float32, a property of the samples, of which the result holds means
        """
        shape = image.shape[0], image.shape[1]
        nearest = samples.nearest(at, self.neighbors, shape, skip_own)
        values, sigma = (np.full(at[0].size, np.nan, np.float32) for _ in range(2))
        confidence, averaged = (np.zeros(at[0].size, np.float32) for _ in range(2))
        marks = np.zeros(samples.values.size, np.float32) if to_average is None else to_average
        _fit(
            nearest, samples.rows, samples.columns, samples.values, image, at[0], at[1], np.float32(max(noise, 1e-9)),
            np.float32(1.0 / (2.0 * self.color_scale**2)), np.float32(self.slope / shape[1]), self.steps,
            marks, values, sigma, confidence, averaged,
        )  # fmt: skip
        return SamplePlanes(values, sigma, confidence, averaged)


@parallel_jit
def _fit(
    nearest, rows, columns, values, image, at_rows, at_columns, noise, color_rate, slope, steps, marks, result, sigma,
    confidence, mark,
):  # fmt: skip
    for p in prange(at_rows.size):
        count = 0
        while count < nearest.shape[1] and nearest[p, count] >= 0:
            count += 1
        if count == 0:
            continue
        y, x = at_rows[p], at_columns[p]
        dx, dy = np.empty(count, np.float32), np.empty(count, np.float32)
        m = np.empty(count, np.float32)
        v, w = np.empty(count, np.float32), np.empty(count, np.float32)
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
        result[p], sigma[p], confidence[p], mark[p] = _plane(dx, dy, v, w, m, total, noise, steep, start, steps)


@jit
def _start(dx, dy, v, w, noise, slope):
    # The value of the sample that the largest weight agrees with, and the standard deviation of slopes at its depth.
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


@jit
def _plane(dx, dy, v, w, m, total, noise, steep, start, steps):
    # Value at the pixel, its standard deviation, the weighted share of inliers and their mean mark.
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
