"""Cross-based aggregation with orthogonal integral images (thesis, eq. 3.8-3.9; Zhang et al. 2009; Mei et al. 2011)."""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.core import memory
from depthcli.core.frames import StereoPair
from depthcli.core.maps import Floats, Image8
from depthcli.kernels.jit import empty, helper, jit, run_bands, zeros
from depthcli.methods.stereo.aggregation import Aggregator
from depthcli.methods.stereo.volume import CostVolume, FixedPoint, as_fixed_point

# Intersected supports, first pass: a word has the sum over an arm above 9 bits for the arm's length. An arm has at most
# 511 pixels of at most 4080.
_LENGTH_BITS = 9
_COLUMNS = 4  # summed side by side
LARGEST_DIFFERENCE = 255  # between two grey levels: a threshold that nothing exceeds


class Cross(Aggregator):
    """Mean over a support bounded by color edges: the horizontal arms of all pixels on the vertical arm.

    Iterations alternate between horizontal-first and vertical-first supports. By default only the reference
    view's support counts. Intersecting it with the target's makes the arms depend on the disparity and doubles the
    time of an iteration. On the four scenes of Middlebury v2 (AD + census, winner-takes-all), one intersected
    iteration has fewer errors (3.3 %) than four with the reference view's support (3.6 %).
    """

    aliases = ("CBCA",)

    length: int = Field(34, ge=1, le=255, description="longest arm of a support (L1), pixels")
    threshold: int = Field(20, ge=0, le=255, description="largest color difference within an arm (tau1), grey levels")
    inner_length: int = Field(
        17, ge=0, le=255, description="arm length beyond which inner_threshold applies (L2), pixels"
    )
    inner_threshold: int = Field(
        6, ge=0, le=255, description="largest color difference beyond inner_length (tau2), grey levels"
    )
    consecutive: bool = Field(
        True,
        description="also compare the consecutive pixels of an arm, by threshold; false: each with the center alone "
        "(thesis, eq. 3.8)",
    )
    iterations: int = Field(4, ge=1, le=16, description="number of aggregations, each of the previous one's means")
    support: Literal["reference", "intersection"] = Field(
        "reference", description="reference: arms of the left view; intersection: cut to the arms of the matched pixel"
    )
    smoothing: bool = Field(True, description="median-filter the image (3 x 3) before arms are grown")

    def arms(self, image: Image8) -> Image8:
        """Return the (4, H, W) uint8 arms of an (H, W, C) image."""
        if self.smoothing:
            image = np.asarray(cv2.medianBlur(image, 3), np.uint8)
        limits = self.length, self.threshold, self.inner_length, self.inner_threshold
        return cross_arms(image, *limits, consecutive=self.consecutive)

    def halo(self) -> int | None:
        # Arms of every iteration follow the arms of the previous one; they see one pixel more, and smoothing another.
        return (self.iterations + 1) * self.length + 2

    def __call__(self, volume: CostVolume, pair: StereoPair) -> CostVolume:
        input_costs = volume.costs
        volume = as_fixed_point(volume)
        arms = self.arms(pair.color8[0])
        source = volume.costs
        if self.support == "intersection":
            # Along d the other view is read backwards; beyond its border, arms of 255 cut nothing.
            target = np.full((4, *pair.shape[:1], pair.shape[1] + volume.n_disparities), 255, np.uint8)
            target[:, :, : pair.shape[1]] = self.arms(pair.color8[1])[:, :, ::-1]
            spans: NDArray[np.uint32] = memory.empty(source.shape, np.uint32)
            for iteration in range(self.iterations):
                along_rows = iteration % 2 == 0
                # A copy of the costs is overwritten, to save memory.
                means = memory.empty(source.shape, np.uint16) if source is input_costs else source
                blocks = _n_blocks(source.shape, along_rows)
                run_bands(_intersected_spans, blocks, source.reshape(-1), arms, target, along_rows, spans)
                blocks = _n_blocks(source.shape, not along_rows)
                run_bands(_intersected_means, blocks, spans.reshape(-1), arms, target, not along_rows, means)
                source = means
            return CostVolume(source, volume.scale)
        sums, means = (memory.empty(source.shape, np.uint16) for _ in range(2))
        # Sums over arms are rounded to 16 bits: if they were cut off, small costs would come out too low.
        shift = max(0, (FixedPoint.LARGEST * (2 * self.length + 1)).bit_length() - 16)
        for iteration in range(self.iterations):
            along_rows = iteration % 2 == 0
            inverse = _inverse_areas(arms, along_rows)
            blocks = _n_blocks(source.shape, along_rows)
            run_bands(_arm_sums, blocks, source.reshape(-1), arms, inverse, sums, shift, False, along_rows)
            blocks = _n_blocks(source.shape, not along_rows)
            run_bands(_arm_sums, blocks, sums.reshape(-1), arms, inverse, means, shift, True, not along_rows)
            source = means
        return CostVolume(means, volume.scale)


def _inverse_areas(arms: Image8, horizontal_first: bool) -> Floats:
    # 1 / number of pixels of every support, (H, W).
    first, second = (arms[:2], arms[2:]) if horizontal_first else (arms[2:], arms[:2])
    spans = first[0].astype(np.int64) + first[1] + 1
    axis = 0 if horizontal_first else 1
    prefix = np.insert(np.cumsum(spans, axis=axis), 0, 0, axis=axis)
    index = np.arange(spans.shape[axis]).reshape((-1, 1) if axis == 0 else (1, -1))
    ends = np.take_along_axis(prefix, index + second[1] + 1, axis)
    areas = ends - np.take_along_axis(prefix, index - second[0].astype(np.int64), axis)
    return np.asarray(1.0 / areas, np.float32)


@helper
def _write(low, high, inverse, out, shift, last):
    # Differences of prefix sums: the last pass turns them into means, the others keep their upper 16 bits.
    if last:
        factor = inverse * np.float32(1 << shift)
        for i in range(out.size):
            out[i] = np.uint16(np.int32(np.float32(np.int32(high[i] - low[i])) * factor + np.float32(0.5)))
    else:
        amount, half = np.uint32(shift), np.uint32((1 << shift) >> 1)
        for i in range(out.size):
            out[i] = np.uint16(np.uint32(high[i] - low[i] + half) >> amount)


# Prefix sums of a flat volume run along lines: rows or columns. A block of columns is summed side by side, so that it
# stays in cache while memory is still read in runs.


def _n_blocks(shape: tuple[int, ...], along_rows: bool) -> int:
    return shape[0] if along_rows else -(-shape[1] // _COLUMNS)


@helper
def _lines(shape, along_rows):
    # Number of lines, pixels per line and lines per block; cells from line to line and from pixel to pixel.
    height, width, n_disparities = shape
    if along_rows:
        return height, width, 1, width * n_disparities, n_disparities
    return width, height, _COLUMNS, n_disparities, width * n_disparities


@jit
def _arm_sums(begin, end, source, arms, inverse, out, shift, last, along_rows):
    # Sums over the arms along a line; the last pass divides them by the number of pixels of the support.
    n_disparities = out.shape[2]
    n_lines, length, block, line_step, step = _lines(out.shape, along_rows)
    side = 0 if along_rows else 2
    for k in range(begin, end):
        first_line = k * block
        n_here = min(block, n_lines - first_line)
        run = n_here * n_disparities
        prefix = empty((length + 1, run), np.uint32)
        prefix[0] = 0
        for n in range(length):
            start = first_line * line_step + n * step
            costs, sums, next_sums = source[start : start + run], prefix[n], prefix[n + 1]
            for i in range(next_sums.size):
                next_sums[i] = sums[i] + np.uint32(costs[i])
        for n in range(length):
            for line in range(n_here):
                y, x = (first_line + line, n) if along_rows else (n, first_line + line)
                offset = line * n_disparities
                low = prefix[n - arms[side, y, x], offset : offset + n_disparities]
                high = prefix[n + arms[side + 1, y, x] + 1, offset : offset + n_disparities]
                _write(low, high, inverse[y, x], out[y, x], shift, last)


# Intersected supports: arms are cut to the arms of the match, so that they depend on the disparity. Both passes still
# read prefix sums, at another place for every d. Sum and number of pixels share a word, so that one difference gives
# both. Unsigned index arithmetic spares the test for negative indices.


@helper
def _cut_differences(prefix, arms, target, y, x, side, at, step, out):
    # out[d] = the difference of flat prefix sums over the arms of (y, x), cut to the arms of its match. The sum before
    # the pixel is at index ``at`` for d = 0; sums of neighbors are ``step`` apart.
    mirror = target.shape[2] - out.size - 1 - x
    before, after = arms[side, y, x], arms[side + 1, y, x]
    cut_before = target[side, y, mirror : mirror + out.size]
    cut_after = target[side + 1, y, mirror : mirror + out.size]
    for d in range(out.size):
        b, a = np.uint64(min(before, cut_before[d])), np.uint64(min(after, cut_after[d]))
        low = np.uint64(at) + np.uint64(d) - b * np.uint64(step)
        out[d] = prefix[low + (a + b + np.uint64(1)) * np.uint64(step)] - prefix[low]


@jit
def _intersected_spans(begin, end, source, arms, target, along_rows, spans):
    # Words of the sum over the arms along a line and, in the lower bits, their length. Prefix sums may overflow, but
    # their differences are correct.
    n_disparities = spans.shape[2]
    n_lines, length, block, line_step, step = _lines(spans.shape, along_rows)
    side = 0 if along_rows else 2
    bits, one = np.uint32(_LENGTH_BITS), np.uint32(1)
    for k in range(begin, end):
        first_line = k * block
        n_here = min(block, n_lines - first_line)
        run = n_here * n_disparities
        prefix = zeros((length + 1) * run, np.uint32)
        for n in range(length):
            start = first_line * line_step + n * step
            costs = source[start : start + run]
            here, there = prefix[n * run : (n + 1) * run], prefix[(n + 1) * run : (n + 2) * run]
            for i in range(costs.size):
                there[i] = here[i] + ((np.uint32(costs[i]) << bits) | one)
        for n in range(length):
            for line in range(n_here):
                y, x = (first_line + line, n) if along_rows else (n, first_line + line)
                _cut_differences(prefix, arms, target, y, x, side, n * run + line * n_disparities, run, spans[y, x])


@jit
def _intersected_means(begin, end, spans, arms, target, along_rows, means):
    # Means from the words of all pixels on the arms along a line. Prefix sums are sum << 32 | number.
    n_disparities = means.shape[2]
    n_lines, length, block, line_step, step = _lines(means.shape, along_rows)
    side = 0 if along_rows else 2
    bits, mask, half_word = np.uint64(_LENGTH_BITS), np.uint64((1 << _LENGTH_BITS) - 1), np.uint64(32)
    for k in range(begin, end):
        first_line = k * block
        n_here = min(block, n_lines - first_line)
        run = n_here * n_disparities
        prefix = zeros((length + 1) * run, np.uint64)
        total = empty(n_disparities, np.uint64)
        for n in range(length):
            start = first_line * line_step + n * step
            packed = spans[start : start + run]
            here, there = prefix[n * run : (n + 1) * run], prefix[(n + 1) * run : (n + 2) * run]
            for i in range(packed.size):
                word = np.uint64(packed[i])
                there[i] = here[i] + (((word >> bits) << half_word) | (word & mask))
        for n in range(length):
            for line in range(n_here):
                y, x = (first_line + line, n) if along_rows else (n, first_line + line)
                _cut_differences(prefix, arms, target, y, x, side, n * run + line * n_disparities, run, total)
                out = means[y, x]
                for d in range(out.size):
                    number = np.float32(np.int32(np.uint32(total[d])))
                    mean = np.float32(np.int32(total[d] >> half_word)) / number
                    out[d] = np.uint16(np.int32(mean + np.float32(0.5)))


def cross_arms(
    image: Image8,
    length: int,
    threshold: int,
    inner_length: int,
    inner_threshold: int,
    consecutive: bool = True,
) -> Image8:
    """Return the arm lengths of every pixel of an (H, W, C) uint8 image: (4, H, W) uint8, left, right, up, down.

    An arm grows while (1) the next pixel differs from the center by at most ``threshold`` and, if ``consecutive``,
    from the second step on, from the pixel before it as well, (2) it is no longer than ``length``, at most 255,
    (3) beyond ``inner_length`` the difference from the center is at most ``inner_threshold``. Differences are the
    largest over the channels. Every arm inside the image has at least one pixel, so that no support is a point.
    (Mei et al. 2011. With one threshold, and not ``consecutive``: thesis, eq. 3.8-3.9; Zhang, Lu & Lafruit 2009.)
    """
    planes = np.ascontiguousarray(image.transpose(2, 0, 1))
    arms = np.empty((4, *image.shape[:2]), np.uint8)
    step_threshold = threshold if consecutive else LARGEST_DIFFERENCE
    run_bands(_grow, planes.shape[1], planes, arms, length, threshold, inner_length, inner_threshold, step_threshold)
    return arms


@helper
def _step(center, neighbor, previous, alive, arm, limit, step_threshold):
    # Arms grow to ``neighbor`` if it differs from ``center`` by at most limit, and from ``previous`` by step_threshold.
    for k in range(center.shape[0]):
        a, b, c = center[k], neighbor[k], previous[k]
        for i in range(alive.size):
            value = np.int16(b[i])
            far = np.uint8(np.int16(abs(np.int16(np.int16(a[i]) - value))) > limit)
            jump = np.uint8(np.int16(abs(np.int16(np.int16(c[i]) - value))) > step_threshold)
            alive[i] = np.uint8(alive[i] & np.uint8(1 - np.uint8(far | jump)))
    for i in range(alive.size):
        arm[i] = np.uint8(arm[i] + alive[i])


@jit
def _grow(begin, end, planes, arms, length, threshold, inner_length, inner_threshold, step_threshold):
    # The arms of a whole row of pixels grow by one step at a time, so that the loop over pixels is branch-free SIMD;
    # ``alive`` marks the arms that still grow.
    _, height, width = planes.shape
    for y in range(begin, end):
        for side in range(4):
            dx = 2 * side - 1 if side < 2 else 0
            dy = 2 * side - 5 if side > 1 else 0
            arm = arms[side, y]
            arm[:] = 0
            alive = np.ones(width, np.uint8)
            for n in range(1, length + 1):
                v = y + n * dy
                if v < 0 or v >= height or n * abs(dx) >= width:
                    break
                limit = np.int16(threshold if n <= inner_length else inner_threshold)
                first, stop = max(0, -n * dx), width - max(0, n * dx)  # pixels whose neighbor is in the image
                there, before = n * dx, n * dx - dx
                _step(
                    planes[:, y, first:stop], planes[:, v, first + there : stop + there],
                    planes[:, v - dy, first + before : stop + before], alive[first:stop], arm[first:stop], limit,
                    np.int16(step_threshold),
                )  # fmt: skip
                if n == 1:
                    arm[first:stop] = 1
