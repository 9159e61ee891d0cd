"""Surfaces of segments: what they are at every pixel, and the detail that a smooth surface leaves out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from depthcli.kernels.jit import jit, parallel_jit, prange

_COLUMNS = 64  # a task of the vertical pass: whole cache lines


@dataclass(frozen=True)
class Surfaces:
    """One surface for each of n segments, in the unit of the values it was fitted to.

    Attributes
    ----------
    coefficients : (n, 6) float64 of 1, x, y, x^2, xy, y^2, where x and y are pixels from ``center`` over ``unit``
    center : (n, 2) float64, y and x, pixels
    bounds : (n, 2) float32, least and greatest value that the surface takes
    scale : (n,) float32, robust standard deviation of the residuals; NaN where nothing was known
    unit : length that x and y are divided by, pixels
    """

    coefficients: NDArray[np.float64]
    center: NDArray[np.float64]
    bounds: NDArray[np.float32]
    scale: NDArray[np.float32]
    unit: float

    def at(self, labels: NDArray[np.int32]) -> NDArray[np.float32]:
        """(H, W) float32 value of the surface that ``labels`` (H, W) name, NaN where they are negative."""
        values = np.empty(labels.shape, np.float32)
        _evaluate(labels, self.coefficients, self.center, self.bounds, self.unit, values)
        return values


@jit
def surface_at(coefficients, center, bounds, unit, s, y, x):  # type: ignore[no-untyped-def]
    """Value of surface ``s`` at (y, x), from the arrays of :class:`Surfaces`; for other kernels."""
    u = (x - center[s, 1]) / unit
    v = (y - center[s, 0]) / unit
    value = (
        coefficients[s, 0] + u * (coefficients[s, 1] + u * coefficients[s, 3])
        + v * (coefficients[s, 2] + u * coefficients[s, 4] + v * coefficients[s, 5])
    )  # fmt: skip
    return min(max(value, np.float64(bounds[s, 0])), np.float64(bounds[s, 1]))


@parallel_jit
def _evaluate(labels, coefficients, center, bounds, unit, values):  # type: ignore[no-untyped-def]
    height, width = labels.shape
    for y in prange(height):
        for x in range(width):
            s = labels[y, x]
            values[y, x] = surface_at(coefficients, center, bounds, unit, s, y, x) if s >= 0 else np.nan


def add_detail(
    surface: NDArray[np.float32],
    known: NDArray[np.float32],
    labels: NDArray[np.int32],
    scale: NDArray[np.float32],
    reach: float,
) -> None:
    """Add to ``surface``, in place, the smoothed residuals of the ``known`` values of the same segment around.

    The weight falls by e in ``reach`` pixels along a path within the segment, first along the row, then along the
    column. Far from all known pixels the surface stays as it is: a residual counts against half a pixel of zeros.

    Parameters
    ----------
    surface, known : (H, W) float32, NaN = unknown
    labels : (H, W) int32
    scale : (n,) float32 of the residuals; those above three count as three
    reach : pixels
    """
    weights = np.empty(surface.shape, np.float32)
    residuals = np.empty(surface.shape, np.float32)
    decay = np.float32(np.exp(-1 / reach))
    _residuals(surface, known, labels, scale, decay, residuals, weights)
    _spread_down(labels, decay, residuals, weights)
    _add(surface, residuals, weights)


@parallel_jit
def _residuals(surface, known, labels, scale, decay, residuals, weights):  # type: ignore[no-untyped-def]
    height, width = surface.shape
    back = np.float32(1) - decay * decay  # the second pass sees what the first has summed up
    for y in prange(height):
        for x in range(width):
            s = labels[y, x]
            residual = known[y, x] - surface[y, x]
            residuals[y, x] = np.float32(0)
            weights[y, x] = np.float32(0)
            if not np.isnan(residual):
                limit = np.float32(3) * scale[s]
                residuals[y, x] = min(max(residual, -limit), limit)
                weights[y, x] = np.float32(1)
            if x > 0 and labels[y, x - 1] == s:
                residuals[y, x] += decay * residuals[y, x - 1]
                weights[y, x] += decay * weights[y, x - 1]
        for x in range(width - 2, -1, -1):
            if labels[y, x + 1] == labels[y, x]:
                residuals[y, x] = back * residuals[y, x] + decay * residuals[y, x + 1]
                weights[y, x] = back * weights[y, x] + decay * weights[y, x + 1]


@parallel_jit
def _spread_down(labels, decay, residuals, weights):  # type: ignore[no-untyped-def]
    height, width = labels.shape
    back = np.float32(1) - decay * decay
    for task in prange((width + _COLUMNS - 1) // _COLUMNS):
        first = task * _COLUMNS
        end = min(first + _COLUMNS, width)
        for y in range(1, height):
            for x in range(first, end):
                if labels[y, x] == labels[y - 1, x]:
                    residuals[y, x] += decay * residuals[y - 1, x]
                    weights[y, x] += decay * weights[y - 1, x]
        for y in range(height - 2, -1, -1):
            for x in range(first, end):
                if labels[y, x] == labels[y + 1, x]:
                    residuals[y, x] = back * residuals[y, x] + decay * residuals[y + 1, x]
                    weights[y, x] = back * weights[y, x] + decay * weights[y + 1, x]


@parallel_jit
def _add(surface, residuals, weights):  # type: ignore[no-untyped-def]
    height, width = surface.shape
    for y in prange(height):
        for x in range(width):
            surface[y, x] += residuals[y, x] / (weights[y, x] + np.float32(0.5))
