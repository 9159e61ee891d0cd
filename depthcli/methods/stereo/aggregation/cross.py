"""Cross-based aggregation with orthogonal integral images (thesis, eq. 3.8-3.9; Zhang et al. 2009; Mei et al. 2011)."""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.core import memory
from depthcli.core.frames import StereoPair
from depthcli.kernels.jit import jit, parallel_jit, prange
from depthcli.methods.stereo.aggregation import Aggregator
from depthcli.methods.stereo.aggregation._intersection import intersected_means
from depthcli.methods.stereo.cross_support import cross_arms
from depthcli.methods.stereo.volume import CostVolume, FixedPoint, as_fixed_point


class Cross(Aggregator):
    """Mean over a support bounded by color edges: the horizontal arms of all pixels on the vertical arm.

    Iterations alternate between horizontal-first and vertical-first supports. By default only the reference
    view's support counts. Intersecting it with the target's makes the arms depend on the disparity, which
    doubles the time of an iteration; on the four scenes of Middlebury v2, winner-takes-all on AD + census, one
    intersected iteration has fewer errors (3.3 %) than four of the reference's (3.6 %).
    """

    aliases = ("CBCA",)

    length: int = Field(34, ge=1, le=255, description="longest arm of a support (L1), pixels")
    threshold: int = Field(20, ge=0, le=255, description="largest color difference within an arm (tau1), grey levels")
    inner_length: int = Field(
        17, ge=0, le=255, description="arm length beyond which inner_threshold holds (L2), pixels"
    )
    inner_threshold: int = Field(
        6, ge=0, le=255, description="largest color difference beyond inner_length (tau2), grey levels"
    )
    iterations: int = Field(4, ge=1, le=16, description="number of aggregations, each of the previous one's means")
    support: Literal["reference", "intersection"] = Field(
        "reference", description="reference: arms of the left view; intersection: cut to those of the matched pixel"
    )
    smoothing: bool = Field(True, description="median-filter the image (3 x 3) before arms are grown")

    def arms(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return the (4, H, W) uint8 arms of an (H, W, C) image."""
        if self.smoothing:
            image = np.asarray(cv2.medianBlur(image, 3), np.uint8)
        return cross_arms(image, self.length, self.threshold, self.inner_length, self.inner_threshold)

    def halo(self) -> int | None:
        # A support reaches as far as two arms that follow each other; arms see one pixel more, smoothing another.
        return (self.iterations + 1) * self.length + 2

    def __call__(self, volume: CostVolume, pair: StereoPair) -> CostVolume:
        input_costs = volume.costs
        volume = as_fixed_point(volume)
        arms = self.arms(pair.color8[0])
        source = volume.costs
        if self.support == "intersection":
            target = self.arms(pair.color8[1])
            for iteration in range(self.iterations):
                out = None if source is input_costs else source  # a copy is overwritten, to save memory
                source = intersected_means(source, arms, target, iteration % 2 == 0, out)
            return CostVolume(source, volume.scale)
        sums, means = (memory.empty(source.shape, np.uint16) for _ in range(2))
        # The sum of an arm is kept in 16 bits, rounded: cut off, small costs would come out too low.
        shift = max(0, (FixedPoint.LARGEST * (2 * self.length + 1)).bit_length() - 16)
        for iteration in range(self.iterations):
            horizontal_first = iteration % 2 == 0
            source = volume.costs if iteration == 0 else means
            inverse = _inverse_areas(arms, horizontal_first)
            if horizontal_first:
                _row_sums(source, arms[0], arms[1], inverse, sums, shift, False)
                _column_sums(sums, arms[2], arms[3], inverse, means, shift, True)
            else:
                _column_sums(source, arms[2], arms[3], inverse, sums, shift, False)
                _row_sums(sums, arms[0], arms[1], inverse, means, shift, True)
        return CostVolume(means, volume.scale)


def _inverse_areas(arms: NDArray[np.uint8], horizontal_first: bool) -> NDArray[np.float32]:
    # 1 / number of pixels of every support, (H, W).
    first, second = (arms[:2], arms[2:]) if horizontal_first else (arms[2:], arms[:2])
    spans = first[0].astype(np.int64) + first[1] + 1
    axis = 0 if horizontal_first else 1
    prefix = np.insert(np.cumsum(spans, axis=axis), 0, 0, axis=axis)
    index = np.arange(spans.shape[axis]).reshape((-1, 1) if axis == 0 else (1, -1))
    ends = np.take_along_axis(prefix, index + second[1] + 1, axis)
    areas = ends - np.take_along_axis(prefix, index - second[0].astype(np.int64), axis)
    return np.asarray(1.0 / areas, np.float32)


@jit
def _write(low, high, inverse, out, shift, last):
    # The differences of prefix sums: the last ones become means, the others keep their upper 16 bits.
    if last:
        factor = inverse * np.float32(1 << shift)
        for i in range(out.size):
            out[i] = np.uint16(np.int32(np.float32(np.int32(high[i] - low[i])) * factor + np.float32(0.5)))
    else:
        amount, half = np.uint32(shift), np.uint32((1 << shift) >> 1)
        for i in range(out.size):
            out[i] = np.uint16(np.uint32(high[i] - low[i] + half) >> amount)


@parallel_jit
def _row_sums(source, before, after, inverse, out, shift, last):
    height, width, n_disparities = source.shape
    for y in prange(height):
        prefix = np.empty((width + 1, n_disparities), np.uint32)
        prefix[0] = 0
        for x in range(width):
            costs = source[y, x]
            sums, next_sums = prefix[x], prefix[x + 1]
            for i in range(next_sums.size):
                next_sums[i] = sums[i] + np.uint32(costs[i])
        for x in range(width):
            low = prefix[x - before[y, x]]
            high = prefix[x + after[y, x] + 1]
            _write(low, high, inverse[y, x], out[y, x], shift, last)


@parallel_jit
def _column_sums(source, before, after, inverse, out, shift, last):
    # Blocks of columns keep the prefix sums in cache while memory is still read in runs.
    height, width, n_disparities = source.shape
    block = 4
    for start in prange((width + block - 1) // block):
        x0 = start * block
        x1 = min(width, x0 + block)
        run = (x1 - x0) * n_disparities
        prefix = np.empty((height + 1, run), np.uint32)
        prefix[0] = 0
        for y in range(height):
            costs = source[y, x0:x1].reshape(run)
            sums, next_sums = prefix[y], prefix[y + 1]
            for i in range(next_sums.size):
                next_sums[i] = sums[i] + np.uint32(costs[i])
        for y in range(height):
            for x in range(x0, x1):
                offset = (x - x0) * n_disparities
                low = prefix[y - before[y, x], offset : offset + n_disparities]
                high = prefix[y + after[y, x] + 1, offset : offset + n_disparities]
                _write(low, high, inverse[y, x], out[y, x], shift, last)
