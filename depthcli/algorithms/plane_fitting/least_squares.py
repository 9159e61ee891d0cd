"""Kernels that all robust fits share: weights of residuals, moments of weighted samples, solvers of normal equations.

They are inlined, so that they serve scalar and vectorized loops.
"""

from __future__ import annotations

import numpy as np

from depthcli.kernels.jit import helper

MAD_TO_SIGMA = 1.4826
"""Standard deviation / median absolute deviation of a normal distribution."""


@helper
def biweight_root(residual):
    """Return ``max(0, 1 - r^2)``, the root of Tukey's biweight, of a float32 residual in units of its gate."""
    return max(np.float32(0), np.float32(1) - residual * residual)


@helper
def huber_weight(residual, limit):
    """Return Huber's weight of a residual: 1 up to ``limit``, ``limit / |r|`` beyond it."""
    return min(1.0, limit / max(abs(residual), 1e-30))


@helper
def plane_slopes(xx, xy, yy, xd, yd, determinant):
    """Return the slopes (a, b) of ``d = a x + b y + c`` by Cramer's rule, from second moments about the means.

    The caller ensures that the determinant, ``xx * yy - xy * xy``, is not 0.
    """
    return (xd * yy - yd * xy) / determinant, (yd * xx - xd * xy) / determinant


@helper
def plane_moments(x, y, d, weights):
    """Return the sums of w, wx, wy, wd, wxx, wxy, wyy, wxd and wyd over samples, (N,) float64 each."""
    s = sx = sy = sd = sxx = sxy = syy = sxd = syd = 0.0
    for i in range(d.size):
        w = weights[i]
        wx, wy = w * x[i], w * y[i]
        s += w
        sx += wx
        sy += wy
        sd += w * d[i]
        sxx += wx * x[i]
        sxy += wx * y[i]
        syy += wy * y[i]
        sxd += wx * d[i]
        syd += wy * d[i]
    return s, sx, sy, sd, sxx, sxy, syy, sxd, syd


@helper
def solve_cholesky(matrix, right, terms, solution):
    """Write the ``solution`` of normal equations by Cholesky's method; return False if the system is singular.

    Only the first ``terms`` unknowns are computed. Only the lower half of ``matrix`` is read; it is overwritten. A
    system is singular if a pivot is not above 1e-8 of its diagonal element.
    """
    for i in range(terms):
        diagonal = matrix[i, i]
        for j in range(i):
            s = matrix[i, j]
            for k in range(j):
                s -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = s / matrix[j, j]
        s = diagonal
        for k in range(i):
            s -= matrix[i, k] * matrix[i, k]
        if not s > 1e-8 * diagonal:
            return False
        matrix[i, i] = np.sqrt(s)
    for i in range(terms):
        s = right[i]
        for k in range(i):
            s -= matrix[i, k] * solution[k]
        solution[i] = s / matrix[i, i]
    for i in range(terms - 1, -1, -1):
        s = solution[i]
        for k in range(i + 1, terms):
            s -= matrix[k, i] * solution[k]
        solution[i] = s / matrix[i, i]
    return True


@helper
def smallest(values, k):
    """Return the k-th smallest of ``values``, counted from 0, by Hoare's selection, which reorders them."""
    low, high = 0, values.size - 1
    while low < high:
        pivot = values[(low + high) >> 1]
        i, j = low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i += 1
                j -= 1
        if k <= j:
            high = j
        elif k >= i:
            low = i
        else:
            break
    return values[k]
