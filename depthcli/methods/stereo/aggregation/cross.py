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
from depthcli.methods.stereo.volume import CostVolume, FixedPoint, as_fixed_point

# First pass of intersections: the sum of an arm, above 9 bits of its length. An arm has at most 511 pixels of at most
# 4080.
_LENGTH_BITS = 9


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


def intersected_means(
    source: NDArray[np.uint16],
    arms: NDArray[np.uint8],
    target: NDArray[np.uint8],
    horizontal_first: bool,
    out: NDArray[np.uint16] | None,
) -> NDArray[np.uint16]:
    """Return means over the first arms of all pixels on the second arm of every pixel, cut to those of its match.

    The cut makes every arm depend on the disparity. Both passes still read prefix sums, at a place of its own for every
    d; sum and number of pixels travel in one word, so that one difference gives both. The (H, W, D) ``source`` is at
    most 4080; ``out``, which it may be, gets the means; None: a new array.
    """
    height, width, n_disparities = source.shape
    # Along d the other view is read backwards; behind its border stands an arm that cuts nothing.
    mirrored = np.full((4, height, width + n_disparities), 255, np.uint8)
    mirrored[:, :, :width] = target[:, :, ::-1]
    spans: NDArray[np.uint32] = memory.empty(source.shape, np.uint32)
    means: NDArray[np.uint16] = memory.empty(source.shape, np.uint16) if out is None else out
    if horizontal_first:
        _row_spans(source, arms, mirrored, spans)
        _intersected_column_means(spans, arms, mirrored, means)
    else:
        _column_spans(source, arms, mirrored, spans)
        _intersected_row_means(spans, arms, mirrored, means)
    return means


# Index arithmetic is unsigned, which spares the test for negative indices.


@parallel_jit
def _row_spans(source, arms, mirrored, spans):
    height, width, n_disparities = source.shape
    bits = np.uint32(_LENGTH_BITS)
    for y in prange(height):
        prefix = np.zeros((width + 1) * n_disparities, np.uint32)
        costs = source[y].reshape(width * n_disparities)
        later = prefix[n_disparities:]
        for i in range(costs.size):
            later[i] = prefix[i] + np.uint32(costs[i])
        for x in range(width):
            before, after = arms[0, y, x], arms[1, y, x]
            cut_before = mirrored[0, y, width - 1 - x : width - 1 - x + n_disparities]
            cut_after = mirrored[1, y, width - 1 - x : width - 1 - x + n_disparities]
            out = spans[y, x]
            for d in range(out.size):
                b, a = np.uint64(min(before, cut_before[d])), np.uint64(min(after, cut_after[d]))
                low = (np.uint64(x) - b) * np.uint64(n_disparities) + np.uint64(d)
                length = a + b + np.uint64(1)
                total = prefix[low + length * np.uint64(n_disparities)] - prefix[low]
                out[d] = np.uint32((total << bits) | np.uint32(length))


@parallel_jit
def _column_spans(source, arms, mirrored, spans):
    height, width, n_disparities = source.shape
    bits = np.uint32(_LENGTH_BITS)
    block = 4
    for start in prange((width + block - 1) // block):
        x0 = start * block
        x1 = min(width, x0 + block)
        run = (x1 - x0) * n_disparities
        prefix = np.zeros((height + 1) * run, np.uint32)
        for y in range(height):
            costs = source[y, x0:x1].reshape(run)
            here = prefix[y * run : (y + 1) * run]
            there = prefix[(y + 1) * run : (y + 2) * run]
            for i in range(costs.size):
                there[i] = here[i] + np.uint32(costs[i])
        for y in range(height):
            for x in range(x0, x1):
                before, after = arms[2, y, x], arms[3, y, x]
                cut_before = mirrored[2, y, width - 1 - x : width - 1 - x + n_disparities]
                cut_after = mirrored[3, y, width - 1 - x : width - 1 - x + n_disparities]
                out = spans[y, x]
                offset = np.uint64((x - x0) * n_disparities)
                for d in range(out.size):
                    b, a = np.uint64(min(before, cut_before[d])), np.uint64(min(after, cut_after[d]))
                    low = (np.uint64(y) - b) * np.uint64(run) + offset + np.uint64(d)
                    length = a + b + np.uint64(1)
                    total = prefix[low + length * np.uint64(run)] - prefix[low]
                    out[d] = np.uint32((total << bits) | np.uint32(length))


@parallel_jit
def _intersected_column_means(spans, arms, mirrored, means):
    height, width, n_disparities = spans.shape
    bits, mask = np.uint64(_LENGTH_BITS), np.uint64((1 << _LENGTH_BITS) - 1)
    block = 4
    for start in prange((width + block - 1) // block):
        x0 = start * block
        x1 = min(width, x0 + block)
        run = (x1 - x0) * n_disparities
        # sum << 32 | number: the number of pixels of a column of arms is far below 2 ** 32
        prefix = np.zeros((height + 1) * run, np.uint64)
        total = np.empty(n_disparities, np.uint64)
        for y in range(height):
            packed = spans[y, x0:x1].reshape(run)
            here = prefix[y * run : (y + 1) * run]
            there = prefix[(y + 1) * run : (y + 2) * run]
            for i in range(packed.size):
                word = np.uint64(packed[i])
                there[i] = here[i] + (((word >> bits) << np.uint64(32)) | (word & mask))
        for y in range(height):
            for x in range(x0, x1):
                before, after = arms[2, y, x], arms[3, y, x]
                cut_before = mirrored[2, y, width - 1 - x : width - 1 - x + n_disparities]
                cut_after = mirrored[3, y, width - 1 - x : width - 1 - x + n_disparities]
                offset = np.uint64((x - x0) * n_disparities)
                for d in range(total.size):
                    b, a = np.uint64(min(before, cut_before[d])), np.uint64(min(after, cut_after[d]))
                    low = (np.uint64(y) - b) * np.uint64(run) + offset + np.uint64(d)
                    total[d] = prefix[low + (a + b + np.uint64(1)) * np.uint64(run)] - prefix[low]
                out = means[y, x]
                for d in range(out.size):
                    number = np.float32(np.int32(np.uint32(total[d])))
                    out[d] = np.uint16(
                        np.int32(np.float32(np.int32(total[d] >> np.uint64(32))) / number + np.float32(0.5))
                    )


@parallel_jit
def _intersected_row_means(spans, arms, mirrored, means):
    height, width, n_disparities = spans.shape
    bits, mask = np.uint64(_LENGTH_BITS), np.uint64((1 << _LENGTH_BITS) - 1)
    for y in prange(height):
        prefix = np.zeros((width + 1) * n_disparities, np.uint64)
        total = np.empty(n_disparities, np.uint64)
        packed = spans[y].reshape(width * n_disparities)
        later = prefix[n_disparities:]
        for i in range(packed.size):
            word = np.uint64(packed[i])
            later[i] = prefix[i] + (((word >> bits) << np.uint64(32)) | (word & mask))
        for x in range(width):
            before, after = arms[0, y, x], arms[1, y, x]
            cut_before = mirrored[0, y, width - 1 - x : width - 1 - x + n_disparities]
            cut_after = mirrored[1, y, width - 1 - x : width - 1 - x + n_disparities]
            for d in range(total.size):
                b, a = np.uint64(min(before, cut_before[d])), np.uint64(min(after, cut_after[d]))
                low = (np.uint64(x) - b) * np.uint64(n_disparities) + np.uint64(d)
                total[d] = prefix[low + (a + b + np.uint64(1)) * np.uint64(n_disparities)] - prefix[low]
            out = means[y, x]
            for d in range(out.size):
                number = np.float32(np.int32(np.uint32(total[d])))
                out[d] = np.uint16(np.int32(np.float32(np.int32(total[d] >> np.uint64(32))) / number + np.float32(0.5)))


def cross_arms(
    image: NDArray[np.uint8], length: int, threshold: int, inner_length: int, inner_threshold: int
) -> NDArray[np.uint8]:
    """Return the arm lengths of every pixel of an (H, W, C) uint8 image: (4, H, W) uint8, left, right, up, down.

    An arm grows while (1) the next pixel differs from the center by at most ``threshold`` and, from the
    second step on, from the pixel before it as well, (2) it is no longer than ``length``, at most 255, (3) beyond
    ``inner_length`` the difference from the center is at most ``inner_threshold``. Differences are the largest
    over the channels. Every arm inside the image has at least one pixel, so that no support is a point.
    (Zhang, Lu & Lafruit 2009, thesis, eq. 3.8-3.9, with the two-threshold rule of Mei et al. 2011.)
    """
    planes = np.ascontiguousarray(image.transpose(2, 0, 1))
    arms = np.empty((4, *image.shape[:2]), np.uint8)
    _grow_horizontal(planes, arms, length, threshold, inner_length, inner_threshold)
    _grow_vertical(planes, arms, length, threshold, inner_length, inner_threshold)
    return arms


# Both kernels advance the arms of a whole row of pixels by one step at a time: the loop over pixels is
# branch-free SIMD, and ``alive`` remembers which arms still grow.


@jit
def _step(center, neighbor, previous, alive, arm, limit, threshold):
    # Arms grow to ``neighbor`` where it differs from ``center`` by at most limit, from ``previous`` by threshold.
    for k in range(center.shape[0]):
        a, b, c = center[k], neighbor[k], previous[k]
        for i in range(alive.size):
            value = np.int16(b[i])
            far = np.uint8(np.int16(abs(np.int16(np.int16(a[i]) - value))) > limit)
            jump = np.uint8(np.int16(abs(np.int16(np.int16(c[i]) - value))) > threshold)
            alive[i] = np.uint8(alive[i] & np.uint8(1 - np.uint8(far | jump)))
    for i in range(alive.size):
        arm[i] = np.uint8(arm[i] + alive[i])


@parallel_jit
def _grow_horizontal(planes, arms, length, threshold, inner_length, inner_threshold):
    _, height, width = planes.shape
    for y in prange(height):
        row = planes[:, y]
        for side in range(2):
            arm = arms[side, y]
            arm[:] = 0
            alive = np.ones(width, np.uint8)
            for step in range(1, min(length, width - 1) + 1):
                limit = np.int16(threshold if step <= inner_length else inner_threshold)
                n = width - step
                if side == 1:
                    _step(row[:, :n], row[:, step:], row[:, step - 1 : width - 1], alive[:n], arm[:n],
                          limit, np.int16(threshold))  # fmt: skip
                else:
                    _step(row[:, step:], row[:, :n], row[:, 1 : n + 1], alive[step:], arm[step:],
                          limit, np.int16(threshold))  # fmt: skip
            for x in range(width):
                room = x if side == 0 else width - 1 - x
                arm[x] = max(arm[x], np.uint8(min(1, room)))


@parallel_jit
def _grow_vertical(planes, arms, length, threshold, inner_length, inner_threshold):
    _, height, width = planes.shape
    for y in prange(height):
        for side in range(2, 4):
            direction = -1 if side == 2 else 1
            room = y if side == 2 else height - 1 - y
            arm = arms[side, y]
            arm[:] = 0
            alive = np.ones(width, np.uint8)
            for step in range(1, min(length, room) + 1):
                limit = np.int16(threshold if step <= inner_length else inner_threshold)
                v = y + direction * step
                _step(planes[:, y], planes[:, v], planes[:, v - direction], alive, arm, limit, np.int16(threshold))
            shortest = np.uint8(min(1, room))
            for x in range(width):
                arm[x] = max(arm[x], shortest)
