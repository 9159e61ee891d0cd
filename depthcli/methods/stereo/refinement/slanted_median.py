"""Weighted median of values extrapolated along the slopes of their surfaces."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from depthcli.algorithms.plane_fitting.window_slopes import color_differences, color_planes, framed, slopes
from depthcli.core.maps import DisparityMap, Floats, Image8
from depthcli.kernels.jit import empty, helper, jit, run_bands
from depthcli.kernels.lanes import (
    LANES,
    SHORT_LANES,
    lane_exp_minus_16,
    lane_max,
    load,
    load_shorts,
    maximum,
    minimum,
    splat,
    store,
    where_at_most,
)
from depthcli.methods.stereo.refinement import Refinement, with_smoothed
from depthcli.methods.stereo.volume import RefinementContext

_STEPS_PER_PIXEL = 8  # resolution of results; finer differences would be noise
BLOCK = SHORT_LANES
"""Pixels of a row whose medians are computed together; the device kernel (slanted.cl) has the same number."""
_DENSE_RADIUS = 3  # larger windows leave out every other pixel; their median is the same
_FAR = np.float32(1e9)  # pixels: beyond all disparities


class SlantedMedian(Refinement):
    """Weighted median as in ``weighted_median``, of values extrapolated to the center of the window.

    A plain median flattens slopes if colors restrict it to one side of its window. Here q votes for the value
    ``d_q + g_q . (p - q)`` at p, with the slope g_q of a plane fitted around q. The weight of the vote is
    ``exp(-color / color_scale - distance / distance_scale)``. The result is a multiple of 1/8 pixel. Pixels without a
    value stay empty. In windows of more than 7 x 7 pixels, every other pixel is used, in a checkerboard pattern.
    """

    needs_costs = False

    radius: int = Field(6, ge=1, le=32, description="half side of the median's window, pixels")
    color_scale: float = Field(
        8.0, gt=0, le=1e4, description="mean color difference at which a weight is 1/e, grey levels"
    )
    distance_scale: float = Field(5.0, gt=0, le=1e4, description="distance at which a weight is 1/e, pixels")
    slope_radius: int = Field(16, ge=4, le=96, description="half side of the window that slopes are fitted in, pixels")
    passes: int = Field(1, ge=1, le=8, description="number of times the median is applied")

    def halo(self) -> int | None:
        return self.passes * self.radius + self.slope_radius

    def __call__(self, disparity: DisparityMap, context: RefinementContext) -> DisparityMap:
        values = self.filtered(disparity.values, context.pair.color8[0], context.volume.n_disparities - 1)
        return with_smoothed(disparity, values)

    def filtered(self, values: Floats, image: Image8, max_disparity: float) -> Floats:
        """Return the filtered (H, W) ``values``, guided by an (H, W, 3) ``image``, within 0 .. ``max_disparity``."""
        radius = self.radius
        valid = ~np.isnan(values)
        planes, trust = color_planes(image, radius), framed(valid.astype(np.float32), radius)
        gradient = framed(slopes(values, image, self.slope_radius), radius)
        distance, rate = self.weights()
        grid = np.argwhere(np.isfinite(distance))
        known, limit = values, np.float32(max_disparity)
        for _ in range(self.passes):
            out = np.empty((len(values), planes.shape[2] - 2 * radius), np.float32)
            run_bands(
                _filter, len(out), planes, framed(known, radius), gradient, trust, grid, distance, rate, limit, out
            )
            known = out[:, : values.shape[1]]
        return np.where(valid, known, np.float32(np.nan))

    def weights(self) -> tuple[Floats, np.float32]:
        """Return sixteenths of the weights' exponents: by place in the window, and for a color difference of 1.

        Places that are left out are infinite: every other one in windows of more than 7 x 7 pixels.
        """
        offsets = np.arange(-self.radius, self.radius + 1)
        distance = (np.hypot(offsets[:, None], offsets[None, :]) / (16 * self.distance_scale)).astype(np.float32)
        if self.radius > _DENSE_RADIUS:
            distance[np.add.outer(offsets, offsets) % 2 != 0] = np.inf
        return distance, np.float32(1 / (16 * 3 * self.color_scale))


@jit
def _filter(begin, end, planes, values, gradient, trust, grid, distance, color_rate, max_disparity, out):
    # All inputs but ``grid`` and ``distance`` have a margin without trust. Medians of a block of pixels are computed
    # together, by halving intervals.
    width = out.shape[1]
    count, radius = grid.shape[0], distance.shape[0] // 2
    row_size = values.shape[1]
    plane_size = values.shape[0] * row_size
    zero, one, far = splat(np.float32(0)), splat(np.float32(1)), splat(_FAR)
    part, rate = splat(np.float32(0.5)), splat(color_rate)
    for y in range(begin, end):
        votes = empty(count * SHORT_LANES, np.float32)
        weights = empty(count * SHORT_LANES, np.float32)
        for x in range(0, width, SHORT_LANES):
            center = (y + radius) * row_size + x + radius
            red, green = load_shorts(planes, center), load_shorts(planes, center + plane_size)
            blue = load_shorts(planes, center + 2 * plane_size)
            low0, low1, high0, high1 = far, far, zero - far, zero - far
            half0, half1 = zero, zero
            for k in range(count):
                dy, dx = grid[k, 0], grid[k, 1]
                there = (y + dy) * row_size + x + dx
                color0, color1 = color_differences(planes, there, plane_size, red, green, blue)
                near = splat(distance[dy, dx])
                back_x, back_y = splat(np.float32(radius - dx)), splat(np.float32(radius - dy))
                at = k * SHORT_LANES
                trust0, trust1 = load(trust, there), load(trust, there + LANES)
                weight = lane_exp_minus_16(near + color0 * rate) * trust0
                store(weights, at, weight)
                half0 = half0 + part * weight
                weight = lane_exp_minus_16(near + color1 * rate) * trust1
                store(weights, at + LANES, weight)
                half1 = half1 + part * weight
                # A vote without a value has no weight, and must not widen the interval either.
                vote = _extrapolated(values, gradient, there, plane_size, back_x, back_y)
                store(votes, at, vote)
                low0 = minimum(low0, vote + (one - trust0) * far)
                high0 = maximum(high0, vote - (one - trust0) * far)
                vote = _extrapolated(values, gradient, there + LANES, plane_size, back_x, back_y)
                store(votes, at + LANES, vote)
                low1 = minimum(low1, vote + (one - trust1) * far)
                high1 = maximum(high1, vote - (one - trust1) * far)
            widest = max(lane_max(high0 - low0), lane_max(high1 - low1))
            while widest > np.float32(0.5 / _STEPS_PER_PIXEL):
                middle0, middle1 = part * (low0 + high0), part * (low1 + high1)
                below0, below1 = zero, zero
                for at in range(0, count * SHORT_LANES, SHORT_LANES):
                    below0 = below0 + where_at_most(load(votes, at), middle0, load(weights, at), zero)
                    below1 = below1 + where_at_most(load(votes, at + LANES), middle1, load(weights, at + LANES), zero)
                low0, high0 = where_at_most(half0, below0, low0, middle0), where_at_most(half0, below0, middle0, high0)
                low1, high1 = where_at_most(half1, below1, low1, middle1), where_at_most(half1, below1, middle1, high1)
                widest *= np.float32(0.5)
            store(out, y * width + x, part * (low0 + high0))
            store(out, y * width + x + LANES, part * (low1 + high1))
        row = out[y]
        for x in range(width):
            row[x] = np.rint(row[x] * np.float32(_STEPS_PER_PIXEL)) / np.float32(_STEPS_PER_PIXEL)
            row[x] = min(max(row[x], np.float32(0)), max_disparity)


@helper
def _extrapolated(values, gradient, at, plane_size, back_x, back_y):
    return load(values, at) + load(gradient, at) * back_x + load(gradient, at + plane_size) * back_y
