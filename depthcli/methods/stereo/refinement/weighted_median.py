"""Weighted median guided by the color image (Ma et al. 2013)."""

from __future__ import annotations

import cv2
import numpy as np
from pydantic import Field

from depthcli.core.maps import DisparityMap, Floats, Status
from depthcli.kernels.jit import empty, helper, jit, run_bands, zeros
from depthcli.kernels.lanes import (
    LANES,
    absolute_difference,
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

_BINS_PER_PIXEL = 8
_DOUBT = np.float32(1e-4)  # share of all weights: much more than the order of additions changes their sums


class WeightedMedian(Refinement):
    """Weighted median of a window; pixels of the center's color count more, and filled pixels less.

    A neighbor's weight is ``exp(-color / color_scale - distance / distance_scale)``, times ``filled_weight``
    if its value was filled. Values are sorted into bins of 1/8 pixel. The result is the center of the median's
    bin, so that whole-pixel maps stay whole. Pixels without a value stay empty.
    """

    needs_costs = False
    aliases = ("WM",)

    radius: int = Field(7, ge=1, le=32, description="half side of the median's window, pixels")
    color_scale: float = Field(
        15.0, gt=0, le=1e4, description="mean color difference at which a weight is 1/e, grey levels"
    )
    distance_scale: float = Field(20.0, gt=0, le=1e4, description="distance at which a weight is 1/e, pixels")
    filled_weight: float = Field(1.0, ge=0, le=1, description="factor of the weights of pixels whose value was filled")
    passes: int = Field(1, ge=1, le=8, description="number of times the median is applied")

    def halo(self) -> int | None:
        return self.passes * self.radius

    def __call__(self, disparity: DisparityMap, context: RefinementContext) -> DisparityMap:
        radius = self.radius
        frame = ((radius, radius), (radius, radius + LANES + -disparity.values.shape[1] % LANES))
        channels = np.ascontiguousarray(context.pair.color8[0].transpose(2, 0, 1))
        planes = np.pad(channels, ((0, 0), *frame))
        by_color, by_distance = self.tables()
        valid = disparity.valid
        filled = (disparity.status & np.uint8(Status.FILLED)) != 0
        trust = np.where(filled, np.float32(self.filled_weight), np.float32(1)) * valid.astype(np.float32)
        trust = np.pad(trust, frame)
        values = disparity.values
        for _ in range(self.passes):
            bins = np.where(valid, values * np.float32(_BINS_PER_PIXEL) + np.float32(0.5), 0).astype(np.uint16)
            window = np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)
            lowest = cv2.erode(np.where(valid, bins, np.uint16(0xFFFF)), window)
            highest = cv2.dilate(bins, window)
            filtered = values.copy()
            run_bands(
                _filter, len(filtered), planes, np.pad(bins, frame), trust, by_color, by_distance, lowest,
                highest, filtered,
            )  # fmt: skip
            values = filtered
        return with_smoothed(disparity, values)

    def tables(self) -> tuple[Floats, Floats]:
        """Return the factors of weights by the sum of channel differences, (766,), and by place, (2 radius + 1)^2."""
        by_color = np.exp(-np.arange(766) / (3.0 * self.color_scale)).astype(np.float32)
        offsets = np.arange(-self.radius, self.radius + 1)
        distance = np.hypot(offsets[:, None], offsets[None, :])
        return by_color, np.exp(-distance / self.distance_scale).astype(np.float32)


@helper
def _equal(low, high):
    # Whether every window of these pixels has at most one value.
    varied = False
    for i in range(low.size):
        varied |= low[i] < high[i]
    return not varied


@helper
def _weigh(colors, trust, shape, by_color, by_distance, first, differences, weights):
    # The weights of the windows of a block of pixels. The first window begins at ``first``. A whole row of a window is
    # looked up at a time, so that vectors are not read right after their numbers were written one by one.
    size, (plane_size, row_size) = by_distance.shape[0], shape
    center = first + (size // 2) * (row_size + 1)
    red, green = load_shorts(colors, center), load_shorts(colors, center + plane_size)
    blue = load_shorts(colors, center + 2 * plane_size)
    for dy in range(size):
        row = weights[dy * size * LANES : (dy + 1) * size * LANES]
        for dx in range(size):
            at = first + dy * row_size + dx
            color = absolute_difference(load_shorts(colors, at), red)
            color = color + absolute_difference(load_shorts(colors, at + plane_size), green)
            store(differences, dx * LANES, color + absolute_difference(load_shorts(colors, at + 2 * plane_size), blue))
        for i in range(row.size):
            row[i] = by_color[np.uint16(differences[i])]
        for dx in range(size):
            near, trusted = splat(by_distance[dy, dx]), load(trust, first + dy * row_size + dx)
            store(row, dx * LANES, load(row, dx * LANES) * near * trusted)


@helper
def _halve(bins, row_size, first, size, weights, found, margin):
    # The medians of a block of pixels, by halving intervals, and their margins. A margin is how far the sums of the
    # weights below the median and up to it are from one half; the median is certain if its margin is positive.
    zero, half, far = splat(np.float32(0)), splat(np.float32(0.5)), splat(np.float32(1e9))
    total, low, high = zero, far, zero - far
    for dy in range(size):
        for dx in range(size):
            weight = load(weights, (dy * size + dx) * LANES)
            value = load(bins, first + dy * row_size + dx)
            total = total + weight
            low = minimum(low, where_at_most(weight, zero, far, value))
            high = maximum(high, where_at_most(weight, zero, zero - far, value))
    low, high, goal = low - half, high + half, half * total
    below_low, below_high = zero, total
    widest = lane_max(high - low)
    while widest >= 1:
        middle, below = half * (low + high), zero
        for dy in range(size):
            for dx in range(size):
                value = load(bins, first + dy * row_size + dx)
                below = below + where_at_most(value, middle, load(weights, (dy * size + dx) * LANES), zero)
        low, below_low = where_at_most(goal, below, low, middle), where_at_most(goal, below, below_low, below)
        high, below_high = where_at_most(goal, below, middle, high), where_at_most(goal, below, below, below_high)
        widest *= np.float32(0.5)
    store(found, 0, high)
    store(margin, 0, minimum(below_high - goal, goal - below_low) - splat(_DOUBT) * total)


@helper
def _count(bins, weights, i, low, high, histogram):
    # The median of pixel ``i`` of a block, whose window has ``bins`` (size, size) from ``low`` to ``high``.
    size, total = bins.shape[0], np.float32(0)
    for dy in range(size):
        for dx in range(size):
            weight = weights[(dy * size + dx) * LANES + i]
            histogram[bins[dy, dx]] += weight
            total += weight
    below, k = histogram[low], low
    while k < high and np.float32(2) * below < total:
        k += 1
        below += histogram[k]
    histogram[low : high + 1] = 0
    histogram[0] = 0  # pixels without trust were counted there, with weight 0
    return k


@jit
def _filter(begin, end, planes, bins, trust, by_color, by_distance, lowest, highest, filtered):
    # All inputs but the last three have a margin without trust. Weights and medians are computed for a block of pixels
    # at a time. If a median is not certain, the weights are added in the order of the window.
    width = filtered.shape[1]
    size, row_size = by_distance.shape[0], bins.shape[1]
    for y in range(begin, end):
        histogram = zeros(np.max(highest[y]) + 1, np.float32)
        weights, differences = empty(size * size * LANES, np.float32), empty((size + 1) * LANES, np.int16)
        found, margin = empty(LANES, np.float32), empty(LANES, np.float32)
        for x0 in range(0, width, LANES):
            x1, first = min(width, x0 + LANES), y * row_size + x0
            if _equal(lowest[y, x0:x1], highest[y, x0:x1]):
                continue
            _weigh(planes, trust, (bins.size, row_size), by_color, by_distance, first, differences, weights)
            _halve(bins, row_size, first, size, weights, found, margin)
            for x in range(x0, x1):
                low, high = np.int64(lowest[y, x]), np.int64(highest[y, x])
                if low >= high or np.isnan(filtered[y, x]):
                    continue
                k = np.int64(found[x - x0])
                if not margin[x - x0] > 0:
                    k = _count(bins[y : y + size, x : x + size], weights, x - x0, low, high, histogram)
                filtered[y, x] = np.float32(k) / np.float32(_BINS_PER_PIXEL)
