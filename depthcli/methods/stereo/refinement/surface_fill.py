"""Fill pixels without a value by continuing the surface behind them."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from pydantic import Field

from depthcli.algorithms.plane_fitting.least_squares import huber_weight, plane_moments, plane_slopes
from depthcli.core.maps import DisparityMap, Status
from depthcli.kernels.jit import jit, parallel_jit, prange
from depthcli.methods.stereo.refinement import Refinement
from depthcli.methods.stereo.volume import RefinementContext


class SurfaceFill(Refinement):
    """Continue the surfaces at both ends of a gap along its row and take the one that lies farther back.

    A gap is an occlusion or the strip on the left that the right camera does not see. Holding the last value
    (``background_fill``) is wrong by more than a pixel a few dozen pixels into a slanted surface. So a plane is
    fitted to the surface each end belongs to: pixels connected to it through steps of at most one pixel,
    by least squares with Huber weights, and the gap's pixels take the plane's values.
    """

    needs_costs: ClassVar[bool] = False
    fills: ClassVar[bool] = True

    rows: int = Field(20, ge=0, le=64, description="rows above and below that the plane is fitted to")
    reach: int = Field(20, ge=1, le=255, description="pixels of each row that the plane is fitted to")
    support: int = Field(30, ge=3, le=32768, description="with fewer pixels than this the last value is held")

    def halo(self) -> int | None:
        return self.rows

    def __call__(self, disparity: DisparityMap, evidence: RefinementContext) -> DisparityMap:
        values = disparity.values.copy()
        largest = np.float32(evidence.volume.disparities - 1)
        _continue_surfaces(disparity.values, values, self.rows, self.reach, self.support, largest)
        filled = np.isnan(disparity.values) & ~np.isnan(values)
        return DisparityMap(values, disparity.status | np.where(filled, np.uint8(Status.FILLED), np.uint8(0)))


@parallel_jit
def _continue_surfaces(values: Any, filled: Any, rows: int, reach: int, support: int, largest: Any) -> None:
    height, width = values.shape
    for y in prange(height):
        sample = np.empty((4, (2 * rows + 1) * reach), np.float64)
        x = 0
        while x < width:
            if not np.isnan(values[y, x]):
                x += 1
                continue
            end = x
            while end < width and np.isnan(values[y, end]):
                end += 1
            left_slope = left_value = right_slope = right_value = 0.0
            if x > 0:
                left_slope, left_value = _plane_along_row(values, y, x - 1, -1, rows, reach, support, sample)
            if end < width:
                right_slope, right_value = _plane_along_row(values, y, end, 1, rows, reach, support, sample)
            for u in range(x, end):
                value: float = np.inf
                if x > 0:
                    value = left_value + left_slope * (u - x + 1)
                if end < width:
                    value = min(value, right_value + right_slope * (u - end))
                if value < np.inf:
                    filled[y, u] = min(largest, np.float32(max(value, 0.0)))
            x = end


@jit
def _plane_along_row(
    values: Any, y: int, x: int, step: int, rows: int, reach: int, support: int, sample: Any
) -> tuple[float, float]:
    """Slope along the row and value at (y, x) of the surface that (y, x) belongs to, seen towards ``step``."""
    height, width = values.shape
    start = values[y, x]
    count = 0
    for sign in (-1, 1):
        column, level = x, start
        for k in range(0 if sign == 1 else 1, rows + 1):
            v = y + sign * k
            if v < 0 or v >= height:
                break
            # The gap's edge moves from row to row: look for the surface near where it was.
            found = -1
            for offset in range(12):
                for side in (step, -step):
                    u = column + offset * side
                    if found < 0 and 0 <= u < width and abs(values[v, u] - level) <= 1.0:
                        found = u
            if found < 0:
                break
            column, level = found, values[v, found]
            last, strangers = level, 0
            for n in range(reach):
                u = found + n * step
                if u < 0 or u >= width:
                    break
                if abs(values[v, u] - last) <= 1.0:
                    strangers = 0
                    last = values[v, u]
                    sample[0, count] = u - x
                    sample[1, count] = v - y
                    sample[2, count] = np.float32(last - start)
                    count += 1
                else:  # another surface, or no value
                    strangers += 1
                    if strangers > 3:
                        break
    if count < support:
        return 0.0, float(start)
    across, down, d, weights = sample[0, :count], sample[1, :count], sample[2, :count], sample[3, :count]
    slope_x = slope_y = offset_d = 0.0
    for iteration in range(4):
        for i in range(count):
            residual = d[i] - (slope_x * across[i] + slope_y * down[i] + offset_d)
            weights[i] = 1.0 if iteration == 0 else huber_weight(residual, 0.5)
        s, sx, sy, sd, sxx, sxy, syy, sxd, syd = plane_moments(across, down, d, weights)
        mean_x, mean_y, mean_d = sx / s, sy / s, sd / s
        # One pixel of variance is added: a thin sample must not yield a steep plane.
        xx = sxx / s - mean_x * mean_x + 1.0
        yy = syy / s - mean_y * mean_y + 1.0
        xy = sxy / s - mean_x * mean_y
        xd = sxd / s - mean_x * mean_d
        yd = syd / s - mean_y * mean_d
        slope_x, slope_y = plane_slopes(xx, xy, yy, xd, yd, xx * yy - xy * xy)
        offset_d = mean_d - slope_x * mean_x - slope_y * mean_y
    return slope_x, float(start) + offset_d
