"""Mean over a square window, in a time that does not depend on its size."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from depthcli.core import memory
from depthcli.core.frames import StereoPair
from depthcli.core.method import Odd
from depthcli.kernels.jit import helper, jit, run_bands, zeros
from depthcli.methods.stereo.aggregation import Aggregator
from depthcli.methods.stereo.volume import CostVolume, FixedPoint, as_fixed_point


class ConstantWindow(Aggregator):
    """Mean of the costs in an n x n window, clipped at the image border."""

    aliases = ("CW",)

    window: Odd = Field(11, ge=1, le=1023, description="side of the averaging window, odd, pixels")

    def halo(self) -> int | None:
        return self.window // 2

    def __call__(self, volume: CostVolume, pair: StereoPair) -> CostVolume:
        if volume.costs.dtype != np.uint8:
            volume = as_fixed_point(volume)
        factor = FixedPoint.FRACTION if volume.costs.dtype == np.uint8 else 1
        means = memory.empty(volume.costs.shape, np.uint16)
        bands = max(1, min(volume.costs.shape[0] // 32, 64))
        run_bands(
            _box_means, bands, volume.costs.reshape(len(means), -1), means, self.window // 2, np.float32(factor), bands
        )
        return CostVolume(means, volume.scale * factor)


@helper
def _add(sums, terms):
    for i in range(sums.size):
        sums[i] += np.uint32(terms[i])


@helper
def _subtract(sums, terms):
    for i in range(sums.size):
        sums[i] -= np.uint32(terms[i])


@helper
def _row_means(columns, window, means, radius, rows, factor):
    # ``columns`` are sums over ``rows`` rows.
    width, n_disparities = means.shape
    window[:] = 0
    for x in range(min(radius, width)):
        _add(window, columns[x * n_disparities : (x + 1) * n_disparities])
    for x in range(width):
        if x + radius < width:
            _add(window, columns[(x + radius) * n_disparities : (x + radius + 1) * n_disparities])
        if x - radius - 1 >= 0:
            _subtract(window, columns[(x - radius - 1) * n_disparities : (x - radius) * n_disparities])
        area = rows * (min(width, x + radius + 1) - max(0, x - radius))
        scale = factor / np.float32(area)
        out = means[x]
        for i in range(out.size):
            out[i] = np.uint16(np.int32(np.float32(np.int32(window[i])) * scale + np.float32(0.5)))


@jit
def _box_means(begin, end, costs, means, radius, factor, bands):
    # One band of rows per task: a running sum of rows (columns), then along x a running sum of columns.
    # Every band begins with new column sums, so the result does not depend on the number of bands.
    height, width, n_disparities = means.shape
    for band in range(begin, end):
        first = band * height // bands
        last = (band + 1) * height // bands
        columns = zeros(width * n_disparities, np.uint32)
        window = zeros(n_disparities, np.uint32)
        for y in range(max(0, first - radius), min(height, first + radius)):
            _add(columns, costs[y])
        for y in range(first, last):
            if y + radius < height:
                _add(columns, costs[y + radius])
            if y - radius - 1 >= 0 and y > first:
                _subtract(columns, costs[y - radius - 1])
            rows = min(height, y + radius + 1) - max(0, y - radius)
            _row_means(columns, window, means[y], radius, rows, factor)
