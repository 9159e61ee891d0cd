"""Weighted median of values extrapolated along the slopes of their surfaces."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.algorithms.plane_fitting.window_slopes import BLOCK, color_planes, framed, slopes
from depthcli.core.maps import DisparityMap
from depthcli.kernels.exponential import exp_minus_16
from depthcli.kernels.jit import jit, parallel_jit, prange
from depthcli.methods.stereo.refinement import Refinement, with_smoothed
from depthcli.methods.stereo.volume import RefinementContext

_STEPS_PER_PIXEL = 8  # resolution of results; finer differences would be noise


class SlantedMedian(Refinement):
    """Weighted median as in ``weighted_median``, of values extrapolated to the center of the window.

    A plain median flattens slopes where colors restrict it to one side of its window. The value of q for p is
    ``d_q + g_q . (p - q)`` with the slope g_q of a plane fitted around q, its weight
    ``exp(-color / color_scale - distance / distance_scale)``. The result is a multiple of 1/8 pixel. Pixels without a
    value stay so.
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

    def filtered(
        self, values: NDArray[np.float32], image: NDArray[np.uint8], max_disparity: float
    ) -> NDArray[np.float32]:
        """Return the filtered (H, W) ``values``, guided by an (H, W, 3) ``image``, within 0 .. ``max_disparity``."""
        radius = self.radius
        valid = ~np.isnan(values)
        planes, trust = color_planes(image, radius), framed(valid.astype(np.float32), radius)
        gradient = framed(slopes(values, image, self.slope_radius), radius)
        distance, rate = self.weights()
        known = np.nan_to_num(values)
        for _ in range(self.passes):
            out = framed(known, 0)
            _filter(planes, framed(known, radius), gradient, trust, distance, rate, out)
            known = np.round(out[:, : values.shape[1]] * np.float32(_STEPS_PER_PIXEL)) / np.float32(_STEPS_PER_PIXEL)
            known = np.clip(known, np.float32(0), np.float32(max_disparity))
        return np.where(valid, known, np.float32(np.nan))

    def weights(self) -> tuple[NDArray[np.float32], np.float32]:
        """Return sixteenths of the weights' exponents: by place in the window, and for a color difference of 1."""
        offsets = np.arange(-self.radius, self.radius + 1)
        distance = (np.hypot(offsets[:, None], offsets[None, :]) / (16 * self.distance_scale)).astype(np.float32)
        return distance, np.float32(1 / (16 * 3 * self.color_scale))


@parallel_jit
def _filter(planes: Any, values: Any, gradient: Any, trust: Any, distance: Any, color_rate: Any, out: Any) -> None:
    # Inputs but ``distance`` have a margin without trust. The medians of a block of pixels are found together, by
    # halving intervals.
    height, width = out.shape
    size = distance.shape[0]
    for y in prange(height):
        votes = np.empty((size * size, BLOCK), np.float32)
        weights = np.empty((size * size, BLOCK), np.float32)
        low, high, half = (np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32))
        below, middle = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
        for x in range(0, width, BLOCK):
            _vote(planes, values, gradient, trust, distance, color_rate, y, x, votes, weights)
            low[:] = np.inf
            high[:] = -np.inf
            half[:] = 0
            for k in range(size * size):
                v, w = votes[k], weights[k]
                for i in range(BLOCK):
                    low[i] = min(low[i], v[i])
                for i in range(BLOCK):
                    high[i] = max(high[i], v[i])
                for i in range(BLOCK):
                    half[i] += np.float32(0.5) * w[i]
            widest = np.float32(0)
            for i in range(BLOCK):
                widest = max(widest, high[i] - low[i])
            while widest > np.float32(0.5 / _STEPS_PER_PIXEL):
                for i in range(BLOCK):
                    middle[i] = np.float32(0.5) * (low[i] + high[i])
                below[:] = 0
                for k in range(size * size):
                    v, w = votes[k], weights[k]
                    for i in range(BLOCK):
                        below[i] += w[i] if v[i] <= middle[i] else np.float32(0)
                for i in range(BLOCK):
                    enough = below[i] >= half[i]
                    high[i] = middle[i] if enough else high[i]
                    low[i] = low[i] if enough else middle[i]
                widest *= np.float32(0.5)
            for i in range(BLOCK):
                out[y, x + i] = np.float32(0.5) * (low[i] + high[i])


@jit
def _vote(
    planes: Any, values: Any, gradient: Any, trust: Any, distance: Any, color_rate: Any, y: int, x: int,
    votes: Any, weights: Any,
) -> None:  # fmt: skip
    size = distance.shape[0]
    radius = size // 2
    v0, u0 = y + radius, x + radius
    red0, green0, blue0 = planes[0, v0, u0 : u0 + BLOCK], planes[1, v0, u0 : u0 + BLOCK], planes[2, v0, u0 : u0 + BLOCK]
    center = values[v0, u0 : u0 + BLOCK]
    for dy in range(size):
        for dx in range(size):
            v, u = y + dy, x + dx
            red, green, blue = planes[0, v, u : u + BLOCK], planes[1, v, u : u + BLOCK], planes[2, v, u : u + BLOCK]
            near, known = distance[dy, dx], trust[v, u : u + BLOCK]
            out = weights[dy * size + dx]
            for i in range(BLOCK):
                color = np.float32(
                    np.int16(abs(np.int16(np.int16(red[i]) - np.int16(red0[i]))))
                    + np.int16(abs(np.int16(np.int16(green[i]) - np.int16(green0[i]))))
                    + np.int16(abs(np.int16(np.int16(blue[i]) - np.int16(blue0[i]))))
                )
                out[i] = exp_minus_16(near + color * color_rate) * known[i]
            value = values[v, u : u + BLOCK]
            across, down = gradient[0, v, u : u + BLOCK], gradient[1, v, u : u + BLOCK]
            vote = votes[dy * size + dx]
            back_x, back_y = np.float32(radius - dx), np.float32(radius - dy)
            for i in range(BLOCK):
                # A vote without a value has no weight, and must not widen the interval either.
                extrapolated = value[i] + across[i] * back_x + down[i] * back_y
                vote[i] = extrapolated if known[i] > np.float32(0) else center[i]
