"""Consensus: the pixels around a pixel vote for its disparity.

A vote volume would be as large as a cost volume. It is never stored: votes are counted for 16 disparities
at a time and read at once.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core import memory
from depthcli.kernels.jit import jit, parallel_jit, prange
from depthcli.methods.stereo.volume import CostVolume

LANES = 16
"""Disparities (or maps) that a support sums at a time."""
NOTHING = np.float32(1e-20)  # instead of 0: what is left of far votes must not become denormal, which is slow


class Support:
    """Sums over the pixels that may vote for a pixel, for 16 disparities at a time.

    Attributes
    ----------
    share : (H, W) float32, 1 / (sum of the weights of a pixel's support)
    """

    share: NDArray[np.float32]

    @abstractmethod
    def sum(self, block: NDArray[np.float32]) -> None:
        """Replace (H, W, 16) float32 ``block`` by its sums over every pixel's support."""

    def _normalize(self, shape: tuple[int, int]) -> None:
        ones = np.ones((*shape, LANES), np.float32)
        self.share = np.ones(shape, np.float32)
        self.sum(ones)
        self.share = np.float32(1.0) / ones[:, :, 0]


class ColorSupport(Support):
    """Weights fall with the distance and with the color change along the way (row first, then column).

    Recursive filters in both directions: from one pixel to the next a vote is multiplied by
    exp(-1 / reach - color step / softness); time does not depend on the reach.

    Parameters
    ----------
    image : (H, W, 3) uint8
    reach : distance at which a vote has decayed to 1/e without any color change, pixels
    softness : color change that does the same, grey levels, largest over the channels
    """

    def __init__(self, image: NDArray[np.uint8], reach: float, softness: float) -> None:
        smooth = cv2.medianBlur(image, 3).astype(np.int16)
        shape = image.shape[:2]
        self._across = np.zeros(shape, np.float32)
        self._down = np.zeros(shape, np.float32)
        self._across[:, 1:] = _decay(smooth[:, 1:] - smooth[:, :-1], reach, softness)
        self._down[1:] = _decay(smooth[1:] - smooth[:-1], reach, softness)
        self._normalize((shape[0], shape[1]))

    def sum(self, block: NDArray[np.float32]) -> None:
        _recurse_rows(block, self._across)
        _recurse_columns(block, self._down)


class WindowSupport(Support):
    """All pixels of a square window, clipped at the image border, with equal weights.

    Parameters
    ----------
    shape : (H, W)
    window : side, odd, pixels
    """

    def __init__(self, shape: tuple[int, int], window: int) -> None:
        self._radius = window // 2
        self._normalize(shape)

    def sum(self, block: NDArray[np.float32]) -> None:
        _slide_rows(block, self._radius)
        _slide_columns(block, self._radius)


def _decay(step: NDArray[np.int16], reach: float, softness: float) -> NDArray[np.float32]:
    decay: NDArray[np.float32] = np.exp(-(1.0 / reach + np.abs(step).max(axis=2) / softness)).astype(np.float32)
    return decay


@dataclass(frozen=True)
class Ballot:
    """Votes of M voters a pixel.

    Attributes
    ----------
    disparities : (M, H, W) int32, 0 .. depth - 1
    weights : (M, H, W) float32 in [0, 1]; rounded to 1/256, which keeps the sums of windows exact
    depth : number of disparities
    tolerance : how far beside the voter's own disparity a vote still counts in full. Where votes are all there
        is, nothing else breaks the ties of neighboring disparities: there they count less and less
    support : who may vote for whom
    """

    disparities: NDArray[np.int32]
    weights: NDArray[np.float32]
    depth: int
    tolerance: int
    support: Support

    def _blocks(self, fading: bool) -> Iterator[tuple[int, NDArray[np.float32]]]:
        voters, height, width = self.disparities.shape
        weights = np.round(self.weights * 256) / np.float32(256 * voters)
        block = memory.empty((height, width, LANES), np.float32)
        for first in range(0, self.depth, LANES):
            _cast(self.disparities, weights, first, self.tolerance, fading, block)
            self.support.sum(block)
            yield first, block

    def shares(self, disparities: NDArray[np.int32]) -> NDArray[np.float32]:
        """(N, H, W) float32 in [0, 1]: share of the votes that (N, H, W) ``disparities`` got."""
        shares = np.zeros(disparities.shape, np.float32)
        for first, block in self._blocks(fading=False):
            _look_up(block, self.support.share, disparities, first, shares)
        return np.minimum(shares, np.float32(1.0))

    def costs(self, base: CostVolume | None, strength: float, largest: int) -> CostVolume:
        """``base`` plus ``strength`` for a disparity nobody votes for, as uint16 fixed point up to ``largest``.

        Parameters
        ----------
        base : (H, W, depth) uint16 costs, whose unit is ``base.scale``; None: the votes alone
        """
        shape = (*self.disparities.shape[1:], self.depth)
        out: NDArray[np.uint16] = memory.empty(shape, np.uint16)
        if base is None:
            known, gain, scale = out, 0.0, largest / strength
        else:
            # costs / scale is at most 1 for a blend of measures
            known, scale = base.costs, largest / (1.0 + strength)
            gain = scale / base.scale
        for first, block in self._blocks(fading=base is None):
            _add(block, self.support.share, known, np.float32(gain), np.float32(strength * scale), first, out)
        return CostVolume(out, scale)


@parallel_jit
def _cast(disparities: Any, weights: Any, first: int, tolerance: int, fading: bool, block: Any) -> None:
    voters, height, width = disparities.shape
    step = np.float32(1.0) / np.float32(tolerance + 1) if fading else np.float32(0.0)
    for y in prange(height):
        block[y, :, :] = NOTHING
        for m in range(voters):
            for x in range(width):
                center = disparities[m, y, x] - first
                for k in range(max(0, center - tolerance), min(16, center + tolerance + 1)):
                    fade = np.float32(abs(k - center)) * step
                    block[y, x, k] += weights[m, y, x] * (np.float32(1.0) - fade)


@parallel_jit
def _look_up(block: Any, share: Any, disparities: Any, first: int, shares: Any) -> None:
    count, height, width = disparities.shape
    for y in prange(height):
        for m in range(count):
            for x in range(width):
                k = disparities[m, y, x] - first
                if 0 <= k < 16:
                    shares[m, y, x] = max(block[y, x, k], np.float32(0.0)) * share[y, x]


@parallel_jit
def _add(block: Any, share: Any, base: Any, gain: Any, strength: Any, first: int, out: Any) -> None:
    height, width, depth = out.shape
    one, half = np.float32(1.0), np.float32(0.5)
    for y in prange(height):
        for x in range(width):
            cells = out[y, x, first : min(depth, first + 16)]
            known = base[y, x, first : min(depth, first + 16)]
            votes = block[y, x]
            s = share[y, x]
            if gain > 0:
                for k in range(cells.size):
                    absent = one - min(max(votes[k] * s, np.float32(0.0)), one)
                    cells[k] = np.uint16(np.int32(np.float32(known[k]) * gain + strength * absent + half))
            else:
                for k in range(cells.size):
                    absent = one - min(max(votes[k] * s, np.float32(0.0)), one)
                    cells[k] = np.uint16(np.int32(strength * absent + half))


@jit
def _recurse(cells: Any, decay: Any) -> None:
    # (N * 16,) in place, forwards, then backwards. One flat array: the constant distance of 16 lets
    # the compiler use SIMD without asking whether two arrays overlap.
    count = decay.size
    for i in range(1, count):
        a = decay[i]
        for k in range(i * 16, i * 16 + 16):
            cells[k] += a * cells[k - 16]
    for i in range(count - 2, -1, -1):
        a = decay[i + 1]
        for k in range(i * 16, i * 16 + 16):
            cells[k] += a * cells[k + 16]


@parallel_jit
def _recurse_rows(block: Any, decay: Any) -> None:
    height, width, _ = block.shape
    for y in prange(height):
        # A private copy: the compiler then knows that nothing else points to it.
        cells = np.empty(width * 16, np.float32)
        column = np.empty(width, np.float32)
        column[:] = decay[y]
        row = block[y].reshape(width * 16)
        cells[:] = row
        _recurse(cells, column)
        row[:] = cells


@parallel_jit
def _recurse_columns(block: Any, decay: Any) -> None:
    # Eight columns a task: their rows are contiguous, and all of it stays in the second-level cache.
    height, width, _ = block.shape
    for strip in prange((width + 7) // 8):
        left = strip * 8
        columns = min(8, width - left)
        cells = np.zeros(height * 128, np.float32)
        for y in range(height):
            source = block[y, left : left + columns].reshape(columns * 16)
            target = cells[y * 128 : y * 128 + columns * 16]
            for k in range(source.size):
                target[k] = source[k]
        for y in range(1, height):
            for x in range(columns):
                a = decay[y, left + x]
                for k in range(y * 128 + x * 16, y * 128 + x * 16 + 16):
                    cells[k] += a * cells[k - 128]
        for y in range(height - 2, -1, -1):
            for x in range(columns):
                a = decay[y + 1, left + x]
                for k in range(y * 128 + x * 16, y * 128 + x * 16 + 16):
                    cells[k] += a * cells[k + 128]
        for y in range(height):
            target = block[y, left : left + columns].reshape(columns * 16)
            source = cells[y * 128 : y * 128 + columns * 16]
            for k in range(target.size):
                target[k] = source[k]


@jit
def _slide(cells: Any, radius: int, sums: Any) -> None:
    # (N, 16) in place: running sum over a window clipped at the ends.
    count = cells.shape[0]
    running = sums[count]
    for k in range(16):
        running[k] = np.float32(0.0)
    for i in range(min(radius, count)):
        for k in range(16):
            running[k] += cells[i, k]
    for i in range(count):
        if i + radius < count:
            for k in range(16):
                running[k] += cells[i + radius, k]
        if i - radius - 1 >= 0:
            for k in range(16):
                running[k] -= cells[i - radius - 1, k]
        for k in range(16):
            sums[i, k] = running[k]
    for i in range(count):
        for k in range(16):
            cells[i, k] = sums[i, k]


@parallel_jit
def _slide_rows(block: Any, radius: int) -> None:
    height, width, _ = block.shape
    for y in prange(height):
        sums = np.empty((width + 1, 16), np.float32)
        _slide(block[y], radius, sums)


@parallel_jit
def _slide_columns(block: Any, radius: int) -> None:
    height, width, _ = block.shape
    for x in prange(width):
        cells = np.empty((height, 16), np.float32)
        sums = np.empty((height + 1, 16), np.float32)
        for y in range(height):
            for k in range(16):
                cells[y, k] = block[y, x, k]
        _slide(cells, radius, sums)
        for y in range(height):
            for k in range(16):
                block[y, x, k] = cells[y, k]
