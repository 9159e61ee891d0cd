"""Depth from scattered, partly wrong samples: at every pixel a plane through those that agree."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from depthcli.kernels.jit import jit, parallel_jit, prange
from depthcli.methods.transparent.nearest import nearest_samples


@dataclass(frozen=True)
class Samples:
    """Inverse depths at some pixels.

    Attributes
    ----------
    rows, columns : (M,) int32
    values : (M,) float32, inverse depth
    """

    rows: NDArray[np.int32]
    columns: NDArray[np.int32]
    values: NDArray[np.float32]

    @classmethod
    def of(cls, inverse: NDArray[np.float32]) -> Samples:
        """All known pixels of an (H, W) map."""
        rows, columns = (axis.astype(np.int32) for axis in np.nonzero(np.isfinite(inverse)))
        return cls(rows, columns, inverse[rows, columns])

    def chosen(self, keep: NDArray[np.bool_]) -> Samples:
        """Those where ``keep`` (M,) is true."""
        return Samples(self.rows[keep], self.columns[keep], self.values[keep])


@dataclass(frozen=True)
class Fit:
    """What samples say about pixels.

    Attributes
    ----------
    values : (P,) float32, inverse depth; NaN where there is no sample
    sigma : (P,) float32, their standard deviation: of the plane at the pixel, and of the surface from the plane
    confidence : (P,) float32 in [0, 1], weighted share of the neighboring samples that lie on the plane
    mark : (P,) float32, weighted mean of those samples' marks; 0 where none were given
    """

    values: NDArray[np.float32]
    sigma: NDArray[np.float32]
    confidence: NDArray[np.float32]
    mark: NDArray[np.float32]


class RobustFit(BaseModel):
    """A plane through the nearest samples of like color that agree with each other, by Tukey's biweight."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    neighbors: int = Field(24, ge=3, le=64, description="nearest samples that are looked at")
    color_scale: float = Field(60.0, gt=0, description="color difference at which a sample counts exp(-1/2), levels")
    slope: float = Field(
        0.8, ge=0, description="usual slope of surfaces: change of the depth across the image's width, over the depth"
    )
    steps: int = Field(5, ge=1, le=50, description="reweighted least squares, from a wide to a narrow gate")

    def __call__(
        self,
        samples: Samples,
        image: NDArray[np.uint8],
        noise: float,
        at: tuple[NDArray[np.int32], NDArray[np.int32]],
        leave_own: bool = False,
        marks: NDArray[np.float32] | None = None,
    ) -> Fit:
        """Fit at pixels.

        Parameters
        ----------
        samples : what is known
        image : (H, W, 3) uint8
        noise : standard deviation of good samples, in the unit of their values
        at : (P,) int32 rows and columns
        leave_own : a sample on the pixel itself does not count
        marks : (M,) float32, anything that is known of the samples

        Returns
        -------
        Fit
        """
        shape = image.shape[0], image.shape[1]
        found = nearest_samples(samples.rows, samples.columns, shape, at, self.neighbors, leave_own)
        values = np.full(at[0].size, np.nan, np.float32)
        sigma = np.full(at[0].size, np.nan, np.float32)
        confidence, mark = np.zeros(at[0].size, np.float32), np.zeros(at[0].size, np.float32)
        marks = np.zeros(samples.values.size, np.float32) if marks is None else marks
        _fit(
            found, samples.rows, samples.columns, samples.values, image, at[0], at[1], np.float32(max(noise, 1e-9)),
            np.float32(1.0 / (2.0 * self.color_scale**2)), np.float32(self.slope / shape[1]), self.steps,
            marks, values, sigma, confidence, mark,
        )  # fmt: skip
        return Fit(values, sigma, confidence, mark)


@parallel_jit
def _fit(
    found: Any, rows: Any, columns: Any, values: Any, image: Any, at_rows: Any, at_columns: Any, noise: Any,
    color_rate: Any, slope: Any, steps: int, marks: Any, result: Any, sigma: Any, confidence: Any, mark: Any,
) -> None:  # fmt: skip
    most = found.shape[1]
    for p in prange(at_rows.size):
        count = 0
        while count < most and found[p, count] >= 0:
            count += 1
        if count == 0:
            continue
        y, x = at_rows[p], at_columns[p]
        dx, dy = np.empty(count, np.float32), np.empty(count, np.float32)
        m = np.empty(count, np.float32)
        v, w = np.empty(count, np.float32), np.empty(count, np.float32)
        last = found[p, count - 1]
        reach = np.float32(max((rows[last] - y) ** 2 + (columns[last] - x) ** 2, 1))
        total = np.float32(0.0)
        for k in range(count):
            s = found[p, k]
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
def _start(dx: Any, dy: Any, v: Any, w: Any, noise: Any, slope: Any) -> Any:
    """The sample that most of the weight agrees with, and the slope that is usual at its depth."""
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
def _plane(
    dx: Any, dy: Any, v: Any, w: Any, m: Any, total: Any, noise: Any, steep: Any, start: Any, steps: int
) -> Any:  # fmt: skip
    """Value at the pixel, its standard deviation, the weighted share of inliers and their mean mark."""
    a, b, c = start, np.float32(0.0), np.float32(0.0)
    variance = np.float32(1.0)
    # Slopes have a Gaussian prior: what the usual slope is to one sample's noise.
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
        b = (p22 * q1 - p12 * q2) / determinant
        c = (p11 * q2 - p12 * q1) / determinant
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
