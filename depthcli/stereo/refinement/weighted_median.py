"""Weighted median guided by the color image (Ma et al. 2013)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import prange
from pydantic import Field

from depthcli.core.maps import DisparityMap, Status
from depthcli.kernels._jit import parallel_jit
from depthcli.stereo.refinement import Refinement
from depthcli.stereo.refinement._evidence import Evidence

_PER_PIXEL = 8  # bins


class WeightedMedian(Refinement):
    """Median of a window in which pixels of the center's color count more, and filled ones less.

    A neighbor's weight is ``exp(-color / color_scale - distance / distance_scale)``, times ``filled_weight``
    where its value was filled. Values are sorted into bins of 1/8 pixel; the result is the center of the
    median's bin (a whole-pixel map stays one). Pixels without a value stay so.
    """

    radius: int = Field(7, ge=1, le=32, description="half side of the window, pixels")
    color_scale: float = Field(15.0, gt=0, description="color difference (mean of channels) of weight 1/e, grey levels")
    distance_scale: float = Field(20.0, gt=0, description="distance of weight 1/e, pixels")
    filled_weight: float = Field(1.0, ge=0, le=1, description="factor of pixels whose value was filled")
    passes: int = Field(1, ge=1, le=8, description="number of times the filter is applied")

    def __call__(self, disparity: DisparityMap, evidence: Evidence) -> DisparityMap:
        planes = np.ascontiguousarray(evidence.pair.color8[0].transpose(2, 0, 1))
        by_color = np.exp(-np.arange(766) / (3.0 * self.color_scale)).astype(np.float32)
        offsets = np.arange(-self.radius, self.radius + 1)
        distance = np.hypot(offsets[:, None], offsets[None, :])
        by_distance = np.exp(-distance / self.distance_scale).astype(np.float32)
        filled = (disparity.status & np.uint8(Status.FILLED)) != 0
        trust = np.where(filled, np.float32(self.filled_weight), np.float32(1))
        trust[~disparity.valid] = 0
        values = disparity.values
        bins = evidence.volume.disparities * _PER_PIXEL + 1
        for _ in range(self.passes):
            filtered = np.empty_like(values)
            _filter(planes, values, trust, by_color, by_distance, bins, filtered)
            values = filtered
        changed = disparity.valid & (values != disparity.values)
        return DisparityMap(values, disparity.status | np.where(changed, np.uint8(Status.SMOOTHED), np.uint8(0)))


@parallel_jit
def _filter(
    planes: Any, values: Any, trust: Any, by_color: Any, by_distance: Any, bins: int, filtered: Any
) -> None:
    height, width = values.shape
    radius = by_distance.shape[0] // 2
    for y in prange(height):
        weight_of = np.zeros(bins, np.float32)
        weights = np.empty(2 * radius + 1, np.float32)
        y0, y1 = max(0, y - radius), min(height, y + radius + 1)
        for x in range(width):
            if np.isnan(values[y, x]):
                filtered[y, x] = np.float32(np.nan)
                continue
            x0, x1 = max(0, x - radius), min(width, x + radius + 1)
            red, green, blue = np.int32(planes[0, y, x]), np.int32(planes[1, y, x]), np.int32(planes[2, y, x])
            total = np.float32(0)
            low, high = bins, 0
            for v in range(y0, y1):
                reds = planes[0, v, x0:x1]
                greens = planes[1, v, x0:x1]
                blues = planes[2, v, x0:x1]
                near = by_distance[v - y + radius, x0 - x + radius : x1 - x + radius]
                trusted = trust[v, x0:x1]
                row = values[v, x0:x1]
                for i in range(row.size):
                    color = (
                        abs(np.int32(reds[i]) - red) + abs(np.int32(greens[i]) - green) + abs(np.int32(blues[i]) - blue)
                    )
                    weights[i] = by_color[color] * near[i] * trusted[i]
                for i in range(row.size):
                    weight = weights[i]
                    if weight > np.float32(0):
                        k = int(row[i] * np.float32(_PER_PIXEL) + np.float32(0.5))
                        weight_of[k] += weight
                        total += weight
                        low = min(low, k)
                        high = max(high, k)
            filtered[y, x] = values[y, x]
            below = np.float32(0)
            found = False
            for k in range(low, high + 1):
                below += weight_of[k]
                if not found and np.float32(2) * below >= total:
                    filtered[y, x] = np.float32(k) / np.float32(_PER_PIXEL)
                    found = True
                weight_of[k] = 0
