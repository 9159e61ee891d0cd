"""Fill pixels without a value by continuing the surface behind them."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from depthcli.algorithms.plane_fitting.least_squares import huber_weight, plane_moments, plane_slopes
from depthcli.core.maps import DisparityMap
from depthcli.kernels.jit import empty, helper, jit, n_threads, run_bands
from depthcli.methods.stereo.refinement import Refinement, with_filled
from depthcli.methods.stereo.volume import RefinementContext

# Chosen with the presets on the Middlebury pairs; the device kernel (fills.cl) has the same values.
_MAX_STEP = 1.0  # pixels of disparity between neighbors of one surface
_EDGE_SHIFT = 12  # columns by which the gap's edge may move from row to row
_MAX_INTERRUPTION = 3  # pixels of other surfaces, or without a value, within a row
_FIT_STEPS = 4  # of least squares, the first without weights
_HUBER_LIMIT = 0.5  # pixels
_RIDGE = 1.0  # square pixels added to the variance of positions: a thin sample must not yield a steep plane


class SurfaceFill(Refinement):
    """Continue the surfaces at both ends of a gap along its row and take the one that is farther back.

    A gap is an occlusion or the strip on the left that the right camera does not see. Repeating the last value
    (``background_fill``) is off by more than a pixel a few dozen pixels into a slanted surface. So a plane is
    fitted to the surface at each end, and the gap's pixels take the plane's values. The fit is by least squares with
    Huber weights, over pixels connected to the end by disparity steps of at most one pixel.
    """

    needs_costs = False
    fills = True

    rows: int = Field(
        20, ge=0, le=64, description="rows above and below a gap's row that the surface's plane is fitted to"
    )
    reach: int = Field(20, ge=1, le=255, description="pixels per row that the surface's plane is fitted to")
    support: int = Field(
        30,
        ge=3,
        le=32768,
        description="smallest number of pixels for a plane; with fewer, the gap takes the value at its end",
    )

    def halo(self) -> int | None:
        return self.rows

    def __call__(self, disparity: DisparityMap, context: RefinementContext) -> DisparityMap:
        values = disparity.values.copy()
        largest = np.float32(context.volume.n_disparities - 1)
        limits, tasks = (self.rows, self.reach, self.support), n_threads()
        run_bands(_continue_surfaces, tasks, disparity.values, values, *limits, largest, tasks)
        return with_filled(disparity, values)


@jit
def _continue_surfaces(begin, end, values, filled, rows, reach, support, largest, n_tasks):
    # Gaps gather in some rows, so a task takes every n-th row.
    height = values.shape[0]
    for task in range(begin, end):
        sample = empty((4, (2 * rows + 1) * reach), np.float64)
        for y in range(task, height, n_tasks):
            _fill_row(values, y, rows, reach, support, largest, sample, filled[y])


@helper
def _fill_row(values, y, rows, reach, support, largest, sample, filled):
    width = values.shape[1]
    x = 0
    while x < width:
        if not np.isnan(values[y, x]):
            x += 1
            continue
        end = x
        while end < width and np.isnan(values[y, end]):
            end += 1
        left_slope = left_value = right_slope = right_value = 0.0
        for step in (-1, 1):  # a loop: with literal arguments the plane would be compiled twice
            at = end if step == 1 else x - 1
            if 0 <= at < width:
                slope, value_there = _plane_along_row(values, y, at, step, rows, reach, support, sample)
                if step == 1:
                    right_slope, right_value = slope, value_there
                else:
                    left_slope, left_value = slope, value_there
        for u in range(x, end):
            value: float = np.inf
            if x > 0:
                value = left_value + left_slope * (u - x + 1)
            if end < width:
                value = min(value, right_value + right_slope * (u - end))
            if value < np.inf:
                filled[u] = min(largest, np.float32(max(value, 0.0)))
        x = end


@helper
def _plane_along_row(values, y, x, step, rows, reach, support, sample):
    # Slope along the row, and value at (y, x), of the surface that begins at (y, x) and continues towards ``step``.
    height, width = values.shape
    start = values[y, x]
    count = 0
    for sign in (-1, 1):
        column, level = x, start
        for k in range(0 if sign == 1 else 1, rows + 1):
            v = y + sign * k
            if v < 0 or v >= height:
                break
            # The gap's edge moves from row to row: look for the surface near the edge of the previous row.
            first = -1
            for offset in range(_EDGE_SHIFT):
                for side in (step, -step):
                    u = column + offset * side
                    if first < 0 and 0 <= u < width and abs(values[v, u] - level) <= _MAX_STEP:
                        first = u
            if first < 0:
                break
            column, level = first, values[v, first]
            last, interruption = level, 0
            for n in range(reach):
                u = first + n * step
                if u < 0 or u >= width:
                    break
                if abs(values[v, u] - last) <= _MAX_STEP:
                    interruption = 0
                    last = values[v, u]
                    sample[0, count] = u - x
                    sample[1, count] = v - y
                    sample[2, count] = np.float32(last - start)
                    count += 1
                else:  # another surface, or no value
                    interruption += 1
                    if interruption > _MAX_INTERRUPTION:
                        break
    if count < support:
        return 0.0, float(start)
    across, down, d, weights = sample[0, :count], sample[1, :count], sample[2, :count], sample[3, :count]
    slope_x = slope_y = offset_d = 0.0
    for iteration in range(_FIT_STEPS):
        for i in range(count):
            residual = d[i] - (slope_x * across[i] + slope_y * down[i] + offset_d)
            weights[i] = 1.0 if iteration == 0 else huber_weight(residual, _HUBER_LIMIT)
        s, sx, sy, sd, sxx, sxy, syy, sxd, syd = plane_moments(across, down, d, weights)
        mean_x, mean_y, mean_d = sx / s, sy / s, sd / s
        xx = sxx / s - mean_x * mean_x + _RIDGE
        yy = syy / s - mean_y * mean_y + _RIDGE
        xy = sxy / s - mean_x * mean_y
        xd = sxd / s - mean_x * mean_d
        yd = syd / s - mean_y * mean_d
        slope_x, slope_y = plane_slopes(xx, xy, yy, xd, yd, xx * yy - xy * xy)
        offset_d = mean_d - slope_x * mean_x - slope_y * mean_y
    return slope_x, float(start) + offset_d
