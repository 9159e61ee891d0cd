"""Consensus: the pixels around a pixel vote for its disparity.

A volume of votes would be as large as a cost volume, so it is never stored: votes are counted for 16 disparities
at a time, and the counts are used before the next 16 are counted.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.core import memory
from depthcli.core.maps import Floats, Image8, Ints
from depthcli.core.method import ConfigModel, Odd
from depthcli.kernels.color_steps import BEFORE, color_steps
from depthcli.kernels.jit import empty, jit, run_bands
from depthcli.kernels.lanes import LANES, load, splat, store
from depthcli.methods.stereo.volume import CostVolume

BLOCK_DEPTH = LANES
"""Disparities, or maps, that a support sums at a time: 16."""
_STRIP = 8  # columns
NO_VOTE = np.float32(1e-20)  # instead of 0: remainders of far votes must not become denormal, which is slow


class Support(ABC):
    """Weighted sums over the pixels that vote for a pixel, for 16 disparities at a time."""

    shape: tuple[int, int]  # (H, W) of the images

    @abstractmethod
    def sum(self, block: Floats) -> None:
        """Replace (H, W, 16) float32 ``block`` by its sums over every pixel's support."""

    def mean(self, planes: Floats, out: Floats | None = None) -> Floats:
        """Return the weighted means over every pixel's support of (N, H, W) float32 planes without negative values."""
        out = np.empty(planes.shape, np.float32) if out is None else out
        block = memory.empty((*self.shape, BLOCK_DEPTH), np.float32)
        inverse_sum = np.empty(self.shape, np.float32)
        last = len(planes) // BLOCK_DEPTH * BLOCK_DEPTH  # this block has room for a plane of ones
        for first in range(last, -1, -BLOCK_DEPTH):
            part = slice(first, first + BLOCK_DEPTH)
            run_bands(_interleave, self.shape[0], planes[part], block)
            self.sum(block)
            if first == last:
                np.divide(np.float32(1.0), block[:, :, -1], out=inverse_sum)
            run_bands(_separate, self.shape[0], block, inverse_sum, out[part])
        return out

    @cached_property
    def inverse_sum(self) -> Floats:
        """(H, W) float32, 1 / (sum of the weights of a pixel's support)."""
        ones = np.ones((*self.shape, BLOCK_DEPTH), np.float32)
        self.sum(ones)
        return np.float32(1.0) / ones[:, :, 0]


class ColorSupport(Support):
    """Weights that fall with the distance and with the color change along the way (row first, then column).

    From one pixel to the next a vote is multiplied by exp(-1 / reach - color step / softness). Recursive filters make
    the sums in a time that does not depend on ``reach`` (pixels). Color steps are the largest over the channels.
    """

    def __init__(self, image: Image8, reach: float, softness: float) -> None:
        smooth = np.asarray(cv2.medianBlur(image, 3), np.uint8)
        self.shape = image.shape[0], image.shape[1]
        self._across, self._down = color_steps(smooth, BEFORE, largest=True)
        self._decay = np.exp(-(1.0 / reach + np.arange(256) / softness)).astype(np.float32)

    def sum(self, block: Floats) -> None:
        run_bands(_recurse_rows, self.shape[0], block, self._across, self._decay)
        run_bands(_recurse_columns, (self.shape[1] + _STRIP - 1) // _STRIP, block, self._down, self._decay)


class WindowSupport(Support):
    """Equal weights for all pixels of a square window, clipped at the image border."""

    def __init__(self, shape: tuple[int, int], window: int) -> None:
        self.shape, self._size = shape, (window, window)

    def sum(self, block: Floats) -> None:
        cv2.boxFilter(block, -1, self._size, dst=block, normalize=False, borderType=cv2.BORDER_CONSTANT)


class Consensus(ConfigModel):
    """The way the pixels around a pixel vote for its disparity, and the weight of a vote."""

    support: Literal["color", "window"] = Field(
        "color", description="color: votes fade with distance and color change; window: all of a square count alike"
    )
    window: Odd = Field(
        65, ge=1, le=255, description="side of the window, odd, pixels; support color fades to 1/e at half of it"
    )
    softness: float = Field(
        15.0, gt=0, le=1e4, description="color change at which a vote of support color fades to 1/e, grey levels"
    )
    tolerance: int = Field(
        1, ge=0, le=16384, description="largest difference from its own disparity at which a vote still counts, pixels"
    )
    vote_cost: float = Field(
        0.4,
        ge=0,
        le=1e3,
        description="cost of a disparity without votes, units of one measure; 0: votes are only used as weights",
    )


@dataclass(frozen=True)
class Ballot:
    """Votes of M voters per pixel."""

    disparities: Ints  # (M, H, W) int32, 0 .. n_disparities - 1
    # (M, H, W) float32 >= 0, how much each vote counts; their sum at a pixel is at most M. Rounded to 1/256 for
    # counting, so that sums over windows are exact.
    vote_weights: Floats
    n_disparities: int  # number of disparities
    tolerance: int  # largest difference from the voter's own disparity at which a vote counts, pixels
    support: Support  # the pixels that vote for each pixel, with their weights

    def _blocks(self, fading: bool) -> Iterator[tuple[int, Floats]]:
        voters, height, width = self.disparities.shape
        weights = np.round(self.vote_weights * 256) / np.float32(256 * voters)
        block = memory.empty((height, width, BLOCK_DEPTH), np.float32)
        for first in range(0, self.n_disparities, BLOCK_DEPTH):
            run_bands(_cast, height, self.disparities, weights, first, self.tolerance, fading, block)
            self.support.sum(block)
            yield first, block

    def shares(self, disparities: Ints) -> Floats:
        """Return the shares in [0, 1] of (N, H, W) ``disparities``; votes count in full up to the tolerance."""
        shares = np.zeros(disparities.shape, np.float32)
        for first, block in self._blocks(fading=False):
            run_bands(_look_up, disparities.shape[1], block, self.support.inverse_sum, disparities, first, shares)
        return np.minimum(shares, np.float32(1.0))

    def costs(self, base: CostVolume | None, strength: float, largest: int) -> CostVolume:
        """Return costs plus ``strength * (1 - share)`` of every disparity: uint16 fixed point, at most ``largest``.

        ``strength`` is in units of ``base.scale``, and with ``base`` votes count in full up to the tolerance. Without
        it, the votes are the only cost. Then they fade linearly with the difference from the voter's disparity, to 0
        one pixel beyond the tolerance, because nothing else distinguishes neighboring disparities.
        """
        shape = (*self.disparities.shape[1:], self.n_disparities)
        out: NDArray[np.uint16] = memory.empty(shape, np.uint16)
        if base is None:
            known, gain, scale = out, 0.0, largest / strength
        else:
            # costs / scale is at most 1 for a blend of measures
            known, scale = base.costs, largest / (1.0 + strength)
            gain = scale / base.scale
        for first, block in self._blocks(fading=base is None):
            run_bands(
                _add, len(out), block, self.support.inverse_sum, known, np.float32(gain),
                np.float32(strength * scale), first, out,
            )  # fmt: skip
        return CostVolume(out, scale)


@jit
def _cast(begin, end, disparities, weights, first, tolerance, fading, block):
    voters, _, width = disparities.shape
    step = np.float32(1.0) / np.float32(tolerance + 1) if fading else np.float32(0.0)
    for y in range(begin, end):
        block[y, :, :] = NO_VOTE
        for m in range(voters):
            for x in range(width):
                center = disparities[m, y, x] - first
                for k in range(max(0, center - tolerance), min(BLOCK_DEPTH, center + tolerance + 1)):
                    fade = np.float32(abs(k - center)) * step
                    block[y, x, k] += weights[m, y, x] * (np.float32(1.0) - fade)


@jit
def _look_up(begin, end, block, inverse_sum, disparities, first, shares):
    count, _, width = disparities.shape
    for y in range(begin, end):
        for m in range(count):
            for x in range(width):
                k = disparities[m, y, x] - first
                if 0 <= k < BLOCK_DEPTH:
                    shares[m, y, x] = max(block[y, x, k], np.float32(0.0)) * inverse_sum[y, x]


@jit
def _add(begin, end, block, inverse_sum, base, gain, strength, first, out):
    _, width, n_disparities = out.shape
    one, half = np.float32(1.0), np.float32(0.5)
    for y in range(begin, end):
        for x in range(width):
            cells = out[y, x, first : min(n_disparities, first + BLOCK_DEPTH)]
            known = base[y, x, first : min(n_disparities, first + BLOCK_DEPTH)]
            votes = block[y, x]
            s = inverse_sum[y, x]
            for k in range(cells.size):
                absent = one - min(max(votes[k] * s, np.float32(0.0)), one)
                cells[k] = np.uint16(np.int32(np.float32(known[k]) * gain + strength * absent + half))


@jit
def _interleave(begin, end, planes, block):
    # Missing planes are ones.
    count, _, width = planes.shape
    for y in range(begin, end):
        for x in range(width):
            for k in range(BLOCK_DEPTH):
                block[y, x, k] = max(planes[k, y, x], NO_VOTE) if k < count else np.float32(1)


@jit
def _separate(begin, end, block, factor, planes):
    count, _, width = planes.shape
    for y in range(begin, end):
        cells, factors = block[y], factor[y]
        for k in range(count):
            row = planes[k, y]
            for x in range(width):
                row[x] = cells[x, k] * factors[x]


@jit
def _recurse_rows(begin, end, block, steps, decay):
    # Forwards, then backwards. The 16 values of a pixel are one vector.
    width = block.shape[1]
    for y in range(begin, end):
        first, last = y * width, (y + 1) * width - 1
        total = load(block, first * LANES)
        for i in range(first + 1, last + 1):
            total = load(block, i * LANES) + splat(decay[steps[y, i - first]]) * total
            store(block, i * LANES, total)
        for i in range(last - 1, first - 1, -1):
            total = load(block, i * LANES) + splat(decay[steps[y, i - first + 1]]) * total
            store(block, i * LANES, total)


@jit
def _recurse_columns(begin, end, block, steps, decay):
    # Strips of columns, whose cells stay in the second-level cache between the two directions.
    height, width, _ = block.shape
    for strip in range(begin, end):
        left = strip * _STRIP
        columns = min(_STRIP, width - left)
        cells = empty(height * _STRIP * LANES, np.float32)
        for x in range(columns):
            store(cells, x * LANES, load(block, (left + x) * LANES))
        for y in range(1, height):
            for x in range(columns):
                at = (y * _STRIP + x) * LANES
                above = load(cells, at - _STRIP * LANES)
                here = load(block, (y * width + left + x) * LANES)
                store(cells, at, here + splat(decay[steps[y, left + x]]) * above)
        for x in range(columns):
            at = ((height - 1) * _STRIP + x) * LANES
            store(block, ((height - 1) * width + left + x) * LANES, load(cells, at))
        for y in range(height - 2, -1, -1):
            for x in range(columns):
                at = (y * _STRIP + x) * LANES
                below = (y + 1) * width + left + x
                total = load(cells, at) + splat(decay[steps[y + 1, left + x]]) * load(block, below * LANES)
                store(block, (below - width) * LANES, total)
