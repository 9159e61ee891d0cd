"""Weighted median guided by the color image (Ma et al. 2013)."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.core.maps import DisparityMap, Status
from depthcli.kernels.jit import jit, parallel_jit, prange
from depthcli.methods.stereo.refinement import Refinement, with_smoothed
from depthcli.methods.stereo.volume import RefinementContext

_BINS_PER_PIXEL = 8
_BLOCK = 16  # pixels whose weights are computed together


class WeightedMedian(Refinement):
    """Weighted median of a window; pixels of the center's color count more, and filled ones less.

    A neighbor's weight is ``exp(-color / color_scale - distance / distance_scale)``, times ``filled_weight``
    where its value was filled. Values are sorted into bins of 1/8 pixel; the result is the center of the
    median's bin (a whole-pixel map stays one). Pixels without a value stay so.
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
        frame = ((radius, radius), (radius, radius + -disparity.values.shape[1] % _BLOCK))
        planes = np.pad(context.pair.color8[0].transpose(2, 0, 1), ((0, 0), *frame))
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
            _filter(planes, np.pad(bins, frame), trust, by_color, by_distance, lowest, highest, filtered)
            values = filtered
        return with_smoothed(disparity, values)

    def tables(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the factors of weights by the sum of channel differences, (766,), and by place, (2 radius + 1)^2."""
        by_color = np.exp(-np.arange(766) / (3.0 * self.color_scale)).astype(np.float32)
        offsets = np.arange(-self.radius, self.radius + 1)
        distance = np.hypot(offsets[:, None], offsets[None, :])
        return by_color, np.exp(-distance / self.distance_scale).astype(np.float32)


@jit
def _equal(low, high):
    # Whether every window of some pixels has at most one value.
    varied = False
    for i in range(low.size):
        varied |= low[i] < high[i]
    return not varied


@jit
def _weigh(planes, trust, by_color, by_distance, y, x0, weights):
    # The weights of the windows of a block of pixels that begins at (y, x0), in a form that compiles to vector code.
    size = by_distance.shape[0]
    middle = x0 + size // 2
    reds = planes[0, y + size // 2, middle : middle + _BLOCK]
    greens = planes[1, y + size // 2, middle : middle + _BLOCK]
    blues = planes[2, y + size // 2, middle : middle + _BLOCK]
    for dy in range(size):
        for dx in range(size):
            start = x0 + dx
            red = planes[0, y + dy, start : start + _BLOCK]
            green = planes[1, y + dy, start : start + _BLOCK]
            blue = planes[2, y + dy, start : start + _BLOCK]
            trusted = trust[y + dy, start : start + _BLOCK]
            near = by_distance[dy, dx]
            out = weights[dy * size + dx]
            for i in range(_BLOCK):
                color = (
                    abs(np.int32(red[i]) - np.int32(reds[i]))
                    + abs(np.int32(green[i]) - np.int32(greens[i]))
                    + abs(np.int32(blue[i]) - np.int32(blues[i]))
                )
                out[i] = by_color[np.uint32(color)] * near * trusted[i]


@parallel_jit
def _filter(planes, bins, trust, by_color, by_distance, lowest, highest, filtered):
    # All inputs but the last three have a margin without trust. Weights are computed for a block of pixels at
    # a time, then each pixel fills and reads its histogram.
    height, width = filtered.shape
    size = by_distance.shape[0]
    for y in prange(height):
        histogram = np.zeros(np.max(highest[y]) + 1, np.float32)
        weights = np.empty((size * size, _BLOCK), np.float32)
        for x0 in range(0, width, _BLOCK):
            x1 = min(width, x0 + _BLOCK)
            if _equal(lowest[y, x0:x1], highest[y, x0:x1]):
                continue
            _weigh(planes, trust, by_color, by_distance, y, x0, weights)
            for x in range(x0, x1):
                low, high = lowest[y, x], highest[y, x]
                if low >= high or np.isnan(filtered[y, x]):
                    continue
                total = np.float32(0)
                for dy in range(size):
                    row = bins[y + dy, x : x + size]
                    first = dy * size
                    for dx in range(row.size):
                        weight = weights[first + dx, x - x0]
                        histogram[row[dx]] += weight
                        total += weight
                below = np.float32(0)
                for k in range(low, high + 1):
                    below += histogram[k]
                    if np.float32(2) * below >= total:
                        filtered[y, x] = np.float32(k) / np.float32(_BINS_PER_PIXEL)
                        break
                for k in range(low, high + 1):
                    histogram[k] = 0
                histogram[0] = 0  # where pixels without trust were counted, with weight 0
