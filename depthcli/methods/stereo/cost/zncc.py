"""Zero-mean normalized cross-correlation of two windows, invariant to a local change of brightness and contrast."""

from __future__ import annotations

from typing import Annotated, ClassVar

import cv2
import numpy as np
from pydantic import Field

from depthcli.core import memory
from depthcli.core.frames import StereoPair
from depthcli.core.maps import Doubles, Floats, Image8
from depthcli.kernels.jit import helper, jit, run_bands, zeros
from depthcli.methods.stereo.cost import CostMeasure, Side, window_check
from depthcli.methods.stereo.volume import CostVolume, fill_outside

_BAND = 16  # rows that one task slides windows over; any number gives the same costs


class Zncc(CostMeasure):
    """``1 - (cov + n^2) / sqrt((var + n^2) (var' + n^2))`` of the grey levels in two windows, at most 1.

    The noise n keeps windows without texture from correlating by chance.
    """

    window: Annotated[tuple[Side, Side], window_check(1023)] = Field(
        (9, 9), description="window width and height, pixels; both odd, area at most 1023"
    )
    noise: float = Field(2.0, gt=0, le=255, description="standard deviation of the image noise, grey levels")
    outside: float = Field(0.8, ge=0, le=1, description="cost of a match outside the right image")

    SCALE: ClassVar[int] = 250

    def halo(self) -> int | None:
        return max(self.window) // 2

    def __call__(self, pair: StereoPair, n_disparities: int) -> CostVolume:
        costs = memory.empty((*pair.shape, n_disparities), np.uint8)
        ry, rx = self.window[1] // 2, self.window[0] // 2
        padded = [np.pad(image, ((ry, ry), (rx, rx)), mode="edge") for image in pair.grey8]
        moments = [_moments(image, self.window, self.noise) for image in padded]
        scale = 1.0 / (self.window[0] * self.window[1])
        run_bands(
            _zncc_volume, (costs.shape[0] + _BAND - 1) // _BAND, padded[0], padded[1], *moments[0], *moments[1],
            scale, np.float32(self.noise**2), costs,
        )  # fmt: skip
        fill_outside(costs, np.uint8(round(self.outside * self.SCALE)))
        return CostVolume(costs, float(self.SCALE))


def _moments(padded: Image8, window: tuple[int, int], noise: float) -> tuple[Doubles, Floats]:
    # Mean of every window, and 1 / sqrt(variance + noise^2), of an image that is padded by half a window.
    ry, rx = window[1] // 2, window[0] // 2
    inner = slice(ry, padded.shape[0] - ry), slice(rx, padded.shape[1] - rx)
    area = window[0] * window[1]
    sums = cv2.boxFilter(padded, cv2.CV_64F, window, normalize=False)[inner]
    squares = cv2.sqrBoxFilter(padded, cv2.CV_64F, window, normalize=False)[inner]
    variance = (squares - sums * sums / area) / area
    return sums / area, (1.0 / np.sqrt(variance + noise**2)).astype(np.float32)


@helper
def _add_products(left, right, sign, mirror, sums):
    columns, n_disparities = sums.shape
    for x in range(columns):
        mirror[columns - 1 - x] = right[x]
    for x in range(columns):
        a = sign * np.int32(left[x])
        column, other = sums[x], mirror[columns - 1 - x : columns - 1 - x + n_disparities]
        for i in range(column.size):
            column[i] += a * other[i]


@jit
def _zncc_volume(begin, end, left, right, left_mean, left_factor, right_mean, right_factor, scale, floor, costs):
    # Sums of products of columns are updated from row to row, sums over windows from column to column.
    height, width, n_disparities = costs.shape
    rows, columns = left.shape
    tall, wide = rows - height + 1, columns - width + 1
    unit, one, half = np.float32(250.0), np.float32(1.0), np.float32(0.5)
    for band in range(begin, end):
        sums = zeros((columns, n_disparities), np.int32)
        mirror = zeros(columns + n_disparities, np.int32)
        total = zeros(n_disparities, np.int32)
        mean = zeros(width + n_disparities, np.float64)
        factor = zeros(width + n_disparities, np.float32)
        first = band * _BAND
        for y in range(first, min(height, first + _BAND)):
            # Rows y .. y + tall - 1 of the padded images; the first row of a band starts from nothing.
            start = y if y == first else y + tall - 1
            for row in range(start, y + tall):
                _add_products(left[row], right[row], np.int32(1), mirror, sums)
            for x in range(width):
                mean[width - 1 - x], factor[width - 1 - x] = right_mean[y, x], right_factor[y, x]
            total[:] = 0
            for x in range(wide - 1):
                column = sums[x]
                for i in range(total.size):
                    total[i] += column[i]
            for x in range(width):
                column = sums[x + wide - 1]
                for i in range(total.size):
                    total[i] += column[i]
                at = width - 1 - x
                means, factors = mean[at : at + n_disparities], factor[at : at + n_disparities]
                m, f = left_mean[y, x], left_factor[y, x]
                out = costs[y, x]
                for i in range(out.size):
                    # In double precision: the difference of two large and nearly equal numbers.
                    covariance = np.float32(np.float64(total[i]) * scale - m * means[i])
                    correlation = (covariance + floor) * (f * factors[i])
                    out[i] = np.uint8(np.int32(unit * min(max(one - correlation, np.float32(0.0)), one) + half))
                column = sums[x]
                for i in range(total.size):
                    total[i] -= column[i]
            if y + 1 < min(height, first + _BAND):
                _add_products(left[y], right[y], np.int32(-1), mirror, sums)
