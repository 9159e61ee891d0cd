"""Polynomials in (x, y), fitted by iteratively reweighted least squares with Huber's weights (thesis chapter 4)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.kernels.jit import jit, parallel_jit, prange
from depthcli.methods.kinect.model import SurfaceModel
from depthcli.methods.kinect.surfaces import Surfaces

_PLANE, _QUADRIC = 30, 100  # known pixels from which a surface has degree 1, 2
_STILL = 0.05  # a surface that moves by less than this share of the sensor's noise is final
_SCALES = 3  # turns after which the scale of the residuals is left as it is
_FEW = 100  # residuals that make a scale
_CONSISTENT = 1.4826  # of the median absolute deviation, for normal residuals


class Polynomial(SurfaceModel):
    """In inverse depth a plane is a polynomial of degree 1."""

    degree: int = Field(1, ge=0, le=2, description="of the polynomial; at most 1 below 100 known pixels, 0 below 30")
    huber: float | None = Field(
        1.345, gt=0, description="k: residuals of u > k scales weigh k / u; null: plain least squares"
    )
    iterations: int = Field(20, ge=1, le=100, description="most reweightings from nothing")
    warm_iterations: int = Field(2, ge=1, le=100, description="reweightings from the surfaces of the frame before")
    samples: int = Field(400, ge=100, description="most pixels of a segment that are looked at, evenly spread")

    def __call__(
        self, values: NDArray[np.float32], labels: NDArray[np.int32], floor: float, start: Surfaces | None = None
    ) -> Surfaces:
        if start is None:
            count = int(labels.max()) + 1
            start = Surfaces(
                coefficients=np.zeros((count, 6)),
                center=np.full((count, 2), np.nan),
                bounds=np.full((count, 2), np.nan, np.float32),
                scale=np.full(count, np.nan, np.float32),
                unit=float(max(labels.shape)),
            )
        fitted = Surfaces(
            start.coefficients.copy(), start.center.copy(), start.bounds.copy(), start.scale.copy(), start.unit
        )
        order, begins = _known_by_segment(labels, values, len(fitted.scale))
        _fit(
            order, begins, values, fitted.coefficients, fitted.center, fitted.bounds, fitted.scale, fitted.unit,
            self.degree, self.huber or np.inf, self.iterations, self.warm_iterations, floor, self.samples,
        )  # fmt: skip
        return fitted


@jit
def _known_by_segment(labels, values, count):  # type: ignore[no-untyped-def]
    """Indices of known pixels grouped by segment (counting sort), and where each group begins."""
    flat, value = labels.ravel(), values.ravel()
    begins = np.zeros(count + 1, np.int64)
    for p in range(flat.size):
        if flat[p] >= 0 and not np.isnan(value[p]):
            begins[flat[p] + 1] += 1
    for s in range(count):
        begins[s + 1] += begins[s]
    order = np.empty(begins[count], np.int32)
    free = begins[:count].copy()
    for p in range(flat.size):
        if flat[p] >= 0 and not np.isnan(value[p]):
            s = flat[p]
            order[free[s]] = p
            free[s] += 1
    return order, begins


@jit
def _select(a, k):  # type: ignore[no-untyped-def]
    """k-th smallest of a (Hoare); reorders a."""
    low, high = 0, a.size - 1
    while low < high:
        pivot = a[(low + high) >> 1]
        i, j = low, high
        while i <= j:
            while a[i] < pivot:
                i += 1
            while a[j] > pivot:
                j -= 1
            if i <= j:
                a[i], a[j] = a[j], a[i]
                i += 1
                j -= 1
        if k <= j:
            high = j
        elif k >= i:
            low = i
        else:
            break
    return a[k]


@jit
def _solve(m, b, terms, out):  # type: ignore[no-untyped-def]
    """Cholesky in place; False where a pivot vanishes beside what it was."""
    for i in range(terms):
        before = m[i, i]
        for j in range(i):
            s = m[i, j]
            for k in range(j):
                s -= m[i, k] * m[j, k]
            m[i, j] = s / m[j, j]
        s = before
        for k in range(i):
            s -= m[i, k] * m[i, k]
        if not s > 1e-8 * before:
            return False
        m[i, i] = np.sqrt(s)
    for i in range(terms):
        s = b[i]
        for k in range(i):
            s -= m[i, k] * out[k]
        out[i] = s / m[i, i]
    for i in range(terms - 1, -1, -1):
        s = out[i]
        for k in range(i + 1, terms):
            s -= m[k, i] * out[k]
        out[i] = s / m[i, i]
    return True


@parallel_jit
def _fit(  # type: ignore[no-untyped-def]
    order, begins, values, coefficients, center, bounds, scale, unit, degree, huber, iterations, warm_iterations,
    floor, samples,
):  # fmt: skip
    for s in prange(begins.size - 1):
        known = begins[s + 1] - begins[s]
        new = np.isnan(center[s, 0])
        if known >= (1 if new else _PLANE):
            turns = iterations if new else warm_iterations
            scale[s] = _fit_one(
                order[begins[s] : begins[s + 1]], values, coefficients[s], center[s], bounds[s], unit, degree, huber,
                turns, floor, samples,
            )  # fmt: skip


@jit
def _fit_one(pixels, values, beta, center, bounds, unit, degree, huber, iterations, floor, samples):  # type: ignore[no-untyped-def]
    """Fit ``beta`` (6,), ``center`` (2,) and ``bounds`` (2,) in place; the scale of the residuals."""
    width = values.shape[1]
    total = pixels.size
    n = min(total, samples)
    z, u, v = np.empty(n), np.empty(n), np.empty(n)
    residuals, scratch, weights = np.empty(n), np.empty(n), np.empty(n)
    for k in range(n):
        p = pixels[k * total // n]
        y, x = p // width, p % width
        z[k], u[k], v[k] = values[y, x], x, y
    scratch[:] = z
    if np.isnan(center[0]):
        center[0], center[1] = v.mean(), u.mean()
        beta[:] = 0
        beta[0] = _select(scratch, n // 2)
    u[:] = (u - center[1]) / unit
    v[:] = (v - center[0]) / unit
    low, high = z.min(), z.max()
    bounds[0] = max(low - 0.05 * (high - low), 0.5 * low)
    bounds[1] = high + 0.05 * (high - low)
    terms = 1
    if total >= _PLANE and degree >= 1:
        terms = 6 if total >= _QUADRIC and degree == 2 else 3
    beta[terms:] = 0
    far_u, far_v = np.abs(u).max(), np.abs(v).max()
    extent = (1.0, far_u, far_v, far_u * far_u, far_u * far_v, far_v * far_v)
    normal, right, new = np.empty((6, 6)), np.empty(6), np.empty(6)
    spread = floor
    for turn in range(iterations):
        _residuals(z, u, v, beta, residuals)
        if turn < _SCALES:
            spread = _spread(residuals, scratch, floor)
        limit = huber * spread
        for k in range(n):
            weights[k] = min(1.0, limit / max(abs(residuals[k]), 1e-30))
        _normal_equations(z, u, v, weights, terms, normal, right)
        if not _solve(normal, right, terms, new):  # the pixels lie on a line
            terms = 3 if terms == 6 else 1
            beta[terms:] = 0
            continue
        change = 0.0  # of the surface, anywhere in the segment, at most
        for i in range(terms):
            change += abs(new[i] - beta[i]) * extent[i]
            beta[i] = new[i]
        if change < _STILL * floor and turn + 1 >= _SCALES:
            break
    _residuals(z, u, v, beta, residuals)
    return np.float32(_spread(residuals, scratch, floor))


@jit
def _normal_equations(z, u, v, weights, terms, normal, right):  # type: ignore[no-untyped-def]
    """Lower half of sum w b b' and sum w b z over the pixels' basis b; the first three terms fast."""
    w0 = wu = wv = wuu = wuv = wvv = wz = wuz = wvz = 0.0
    for k in range(z.size):
        w = weights[k]
        a, b = w * u[k], w * v[k]
        w0 += w
        wu += a
        wv += b
        wuu += a * u[k]
        wuv += a * v[k]
        wvv += b * v[k]
        wz += w * z[k]
        wuz += a * z[k]
        wvz += b * z[k]
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


@jit
def _residuals(z, u, v, beta, out):  # type: ignore[no-untyped-def]
    for k in range(out.size):
        out[k] = z[k] - (
            beta[0] + u[k] * (beta[1] + u[k] * beta[3]) + v[k] * (beta[2] + u[k] * beta[4] + v[k] * beta[5])
        )


@jit
def _spread(residuals, scratch, floor):  # type: ignore[no-untyped-def]
    """Robust standard deviation by the median absolute deviation of evenly spread residuals, at least ``floor``."""
    n = residuals.size
    few = min(n, _FEW)
    sample = scratch[:few]
    for k in range(few):
        sample[k] = residuals[k * n // few]
    middle = _select(sample, few // 2)
    for k in range(few):
        sample[k] = abs(residuals[k * n // few] - middle)
    return max(_CONSISTENT * _select(sample, few // 2), floor)
