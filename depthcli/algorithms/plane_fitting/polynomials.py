"""Polynomials in (x, y), one per segment, fitted by reweighted least squares (thesis, section 4)."""

from __future__ import annotations

import copy
from typing import Literal, NamedTuple

import numpy as np
from pydantic import Field

from depthcli.algorithms.plane_fitting import least_squares
from depthcli.algorithms.plane_fitting.least_squares import MAD_TO_SIGMA, huber_weight, smallest
from depthcli.algorithms.regions import RegionPixels
from depthcli.core.maps import Doubles, Floats, Ints
from depthcli.core.method import ConfigModel
from depthcli.kernels.jit import empty, helper, jit, run_bands

# Values of the published preset refine-kinect dsrm; nothing in the repository varies them.
_MIN_PLANE_PIXELS, _MIN_QUADRIC_PIXELS = 30, 100  # smallest numbers of known pixels for degrees 1 and 2
_CONVERGED = 0.05  # a surface that moves by less than this share of the scale's floor has converged
_GOLDEN_RATIO = 0.6180339887498949  # its multiples modulo 1 are evenly spread
_SCALE_SAMPLES = 100  # number of residuals for the estimate of the scale


class Surfaces(NamedTuple):
    """One surface for each of n segments, in the unit of the fitted values."""

    # (n, 6) float64, for 1, x, y, x^2, xy, y^2, with x and y in pixels from ``center``, divided by ``unit``
    coefficients: Doubles
    center: Doubles  # (n, 2) float64, y and x, pixels
    # (n, 2) float32, smallest and largest value of the surface; values are clipped to them
    bounds: Floats
    scale: Floats  # (n,) float32, robust standard deviation of the residuals; NaN if no pixel was known
    unit: float  # unit of x and y, pixels

    def at(self, labels: Ints) -> Floats:
        """Return the value of each pixel's surface, given its label; (H, W) float32, NaN for negative labels."""
        values = np.empty(labels.shape, np.float32)
        run_bands(_evaluate, len(labels), labels, self, values)
        return values


@helper
def surface_at(surfaces, s, y, x):
    """Return the value of surface ``s`` of :class:`Surfaces` at (y, x)."""
    beta, center, bounds = surfaces.coefficients, surfaces.center, surfaces.bounds
    u = (x - center[s, 1]) / surfaces.unit
    v = (y - center[s, 0]) / surfaces.unit
    value = beta[s, 0] + u * (beta[s, 1] + u * beta[s, 3]) + v * (beta[s, 2] + u * beta[s, 4] + v * beta[s, 5])
    return min(max(value, np.float64(bounds[s, 0])), np.float64(bounds[s, 1]))


@jit
def _evaluate(begin, end, labels, surfaces, values):
    width = labels.shape[1]
    for y in range(begin, end):
        for x in range(width):
            s = labels[y, x]
            value = np.nan
            if s >= 0:
                value = surface_at(surfaces, np.int64(s), float(y), float(x))
            values[y, x] = value


class Polynomial(ConfigModel):
    """Polynomials of inverse depth in (x, y), fitted to every segment by reweighted least squares (Huber)."""

    method: Literal["polynomial"] = Field("polynomial", description="name of the model")
    degree: int = Field(
        1,
        ge=0,
        le=2,
        description="degree of the polynomial; at most 1 with fewer than 100 known pixels, 0 with fewer than 30",
    )
    huber: float | None = Field(1.345, gt=0, description="residuals of u > k scales weigh k / u; null: least squares")
    iterations: int = Field(20, ge=1, le=100, description="largest number of reweightings, without a previous frame")
    warm_iterations: int = Field(2, ge=1, le=100, description="reweightings from the surfaces of the previous frame")
    samples: int = Field(400, ge=100, description="largest number of pixels per segment that are used, evenly spread")

    def __call__(self, values: Floats, labels: Ints, floor: float, start: Surfaces | None = None) -> Surfaces:
        """Fit a surface to the known ``values`` (H, W), NaN = unknown, in each segment.

        ``labels`` is (H, W), 0 .. n - 1, -1 = no segment. ``floor`` is the smallest scale of residuals, e.g. the
        sensor's resolution. ``start`` are n initial surfaces, such as the previous frame's for the same segments;
        a segment with fewer than 30 known pixels keeps its initial surface.
        """
        if start is None:
            count, nan = int(labels.max()) + 1, np.float32(np.nan)
            bounds, scale = np.full((count, 2), nan), np.full(count, nan)
            start = Surfaces(np.zeros((count, 6)), np.full((count, 2), np.nan), bounds, scale, float(max(labels.shape)))
        fitted = copy.deepcopy(start)
        known = RegionPixels.of(labels, (labels >= 0) & ~np.isnan(values), len(fitted.scale))
        limits = self.degree, self.huber or np.inf, self.iterations, self.warm_iterations, floor, self.samples
        run_bands(_fit, known.starts.size - 1, known.order, known.starts, values, fitted, *limits)
        return fitted


@jit
def _fit(begin, end, order, begins, values, surfaces, degree, huber, cold, warm, floor, samples):
    beta, center, bounds, scale, unit = surfaces
    for s in range(begin, end):
        known = begins[s + 1] - begins[s]
        new = np.isnan(center[s, 0])
        if known >= (1 if new else _MIN_PLANE_PIXELS):
            turns = cold if new else warm
            pixels = order[begins[s] : begins[s + 1]]
            shape = beta[s], center[s], bounds[s]
            scale[s] = _fit_one(pixels, values, *shape, unit, degree, huber, turns, floor, samples)


@helper
def _fit_one(pixels, values, beta, center, bounds, unit, degree, huber, iterations, floor, samples):
    # Fit ``beta`` (6,), ``center`` (2,) and ``bounds`` (2,) in place; return the scale of the residuals.
    width = values.shape[1]
    total = pixels.size
    n = min(total, samples)
    z, u, v = empty(n, np.float64), empty(n, np.float64), empty(n, np.float64)
    residuals, scratch, weights = empty(n, np.float64), empty(n, np.float64), empty(n, np.float64)
    low, high, far_u, far_v = np.inf, -np.inf, 0.0, 0.0
    for k in range(n):  # one pixel of each n-th part; in a rectangle, the first of each could form a column
        first, end = k * total // n, (k + 1) * total // n
        p = pixels[first + int((end - first) * (k * _GOLDEN_RATIO % 1.0))]
        y, x = p // width, p % width
        z[k], u[k], v[k] = values[y, x], x, y
        scratch[k] = z[k]
        low, high = min(low, z[k]), max(high, z[k])
    if np.isnan(center[0]):
        center[0], center[1] = v.mean(), u.mean()
        beta[:] = 0
        beta[0] = smallest(scratch, n // 2)
    for k in range(n):
        u[k] = (u[k] - center[1]) / unit
        far_u = max(far_u, abs(u[k]))
    for k in range(n):
        v[k] = (v[k] - center[0]) / unit
        far_v = max(far_v, abs(v[k]))
    bounds[0] = max(low - 0.05 * (high - low), 0.5 * low)
    bounds[1] = high + 0.05 * (high - low)
    terms = 1
    if total >= _MIN_PLANE_PIXELS and degree >= 1:
        terms = 6 if total >= _MIN_QUADRIC_PIXELS and degree == 2 else 3
    beta[terms:] = 0
    extent = (1.0, far_u, far_v, far_u * far_u, far_u * far_v, far_v * far_v)
    normal, right, new = empty((6, 6), np.float64), empty(6, np.float64), empty(6, np.float64)
    spread = np.inf
    for _ in range(iterations):
        _residuals(z, u, v, beta, residuals)
        # The scale only falls. A scale that grew with the residuals would let outliers pull the surface further.
        spread = min(spread, _spread(residuals, scratch, floor))
        limit = huber * spread
        for k in range(n):
            weights[k] = huber_weight(residuals[k], limit)
        _normal_equations(z, u, v, weights, terms, normal, right)
        if not least_squares.solve_cholesky(normal, right, terms, new):  # the pixels are on a line
            terms = 3 if terms == 6 else 1
            beta[terms:] = 0
            continue
        change = 0.0  # upper limit of the surface's change anywhere in the segment
        for i in range(terms):
            change += abs(new[i] - beta[i]) * extent[i]
            beta[i] = new[i]
        if change < _CONVERGED * floor:
            break
    _residuals(z, u, v, beta, residuals)
    return np.float32(_spread(residuals, scratch, floor))


@helper
def _normal_equations(z, u, v, weights, terms, normal, right):
    # Write the lower half of sum w b b', and sum w b z, for the basis b = (1, u, v, u^2, uv, v^2).
    w0, wu, wv, wz, wuu, wuv, wvv, wuz, wvz = least_squares.plane_moments(u, v, z, weights)
    normal[0, 0], normal[1, 0], normal[2, 0] = w0, wu, wv
    normal[1, 1], normal[2, 1], normal[2, 2] = wuu, wuv, wvv
    right[0], right[1], right[2] = wz, wuz, wvz
    if terms <= 3:
        return
    normal[3:, :] = 0
    right[3:] = 0
    basis = np.ones(6)
    for k in range(z.size):
        basis[1], basis[2] = u[k], v[k]
        basis[3], basis[4], basis[5] = u[k] * u[k], u[k] * v[k], v[k] * v[k]
        for i in range(3, terms):
            weighted = weights[k] * basis[i]
            right[i] += weighted * z[k]
            for j in range(i + 1):
                normal[i, j] += weighted * basis[j]


@helper
def _residuals(z, u, v, beta, out):
    for k in range(out.size):
        out[k] = z[k] - (
            beta[0] + u[k] * (beta[1] + u[k] * beta[3]) + v[k] * (beta[2] + u[k] * beta[4] + v[k] * beta[5])
        )


@helper
def _spread(residuals, scratch, floor):
    # Return the standard deviation, from the median absolute deviation of evenly spread residuals, at least ``floor``.
    n = residuals.size
    count = min(n, _SCALE_SAMPLES)
    sample = scratch[:count]
    for k in range(count):
        sample[k] = residuals[k * n // count]
    middle = smallest(sample, count // 2)
    for k in range(count):
        sample[k] = abs(residuals[k * n // count] - middle)
    return max(MAD_TO_SIGMA * smallest(sample, count // 2), floor)
