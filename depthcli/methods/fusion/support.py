"""Supports: the pixels around a pixel that vote for it, weighted by color or all alike, and sums over them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.kernels.jit import parallel_jit, prange
from depthcli.kernels.lanes import LANES, load, splat, store

BLOCK_DEPTH = LANES
"""Disparities, or maps, that a support sums at a time: 16."""
_STRIP = 8  # columns
NO_VOTE = np.float32(1e-20)  # instead of 0: what is left of far votes must not become denormal, which is slow

_SOFTNESS = 15.0  # of the supports by which maps are judged, grey levels


class Support(ABC):
    """Weighted sums over the pixels that vote for a pixel, for 16 disparities at a time.

    Attributes
    ----------
    inverse_sum : (H, W) float32, 1 / (sum of the weights of a pixel's support)
    """

    inverse_sum: NDArray[np.float32]

    @abstractmethod
    def sum(self, block: NDArray[np.float32]) -> None:
        """Replace (H, W, 16) float32 ``block`` by its sums over every pixel's support."""

    def _normalize(self, shape: tuple[int, int]) -> None:
        ones = np.ones((*shape, BLOCK_DEPTH), np.float32)
        self.inverse_sum = np.ones(shape, np.float32)
        self.sum(ones)
        self.inverse_sum = np.float32(1.0) / ones[:, :, 0]


class ColorSupport(Support):
    """Weights that fall with the distance and with the color change along the way (row first, then column).

    From one pixel to the next a vote is multiplied by exp(-1 / reach - color step / softness). Sums are made by
    recursive filters, whose time does not depend on the reach.

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


def wide_support(image: NDArray[np.uint8]) -> ColorSupport:
    """Return the wide support of an (H, W, 3) image, by which maps are judged; networks are trained with it."""
    return ColorSupport(image, 8.0, _SOFTNESS)


def narrow_support(image: NDArray[np.uint8]) -> ColorSupport:
    """Return the narrow support, which is used where outlines matter."""
    return ColorSupport(image, 2.0, _SOFTNESS)


class WindowSupport(Support):
    """Equal weights of all pixels of a square window, clipped at the image border.

    Parameters
    ----------
    shape : (H, W)
    window : side, odd, pixels
    """

    def __init__(self, shape: tuple[int, int], window: int) -> None:
        self._size = (window, window)
        self._normalize(shape)

    def sum(self, block: NDArray[np.float32]) -> None:
        cv2.boxFilter(block, -1, self._size, dst=block, normalize=False, borderType=cv2.BORDER_CONSTANT)


def _decay(step: NDArray[np.int16], reach: float, softness: float) -> NDArray[np.float32]:
    largest = np.abs(step[:, :, 0])
    for channel in range(1, step.shape[2]):  # several times as fast as a maximum over the last axis
        np.maximum(largest, np.abs(step[:, :, channel]), out=largest)
    decay: NDArray[np.float32] = np.exp(-(1.0 / reach + largest / softness)).astype(np.float32)
    return decay


@parallel_jit
def _recurse_rows(block: Any, decay: Any) -> None:
    # Forwards, then backwards; 16 values a pixel, which are one vector.
    height, width, _ = block.shape
    cells = block.reshape(height * width * LANES)
    for y in prange(height):
        first, last = y * width, (y + 1) * width - 1
        total = load(cells, first * LANES)
        for i in range(first + 1, last + 1):
            total = load(cells, i * LANES) + splat(decay[y, i - first]) * total
            store(cells, i * LANES, total)
        for i in range(last - 1, first - 1, -1):
            total = load(cells, i * LANES) + splat(decay[y, i - first + 1]) * total
            store(cells, i * LANES, total)


@parallel_jit
def _recurse_columns(block: Any, decay: Any) -> None:
    # Strips of columns, whose cells stay in the second-level cache between both directions.
    height, width, _ = block.shape
    source = block.reshape(height * width * LANES)
    for strip in prange((width + _STRIP - 1) // _STRIP):
        left = strip * _STRIP
        columns = min(_STRIP, width - left)
        cells = np.empty(height * _STRIP * LANES, np.float32)
        for x in range(columns):
            store(cells, x * LANES, load(source, (left + x) * LANES))
        for y in range(1, height):
            for x in range(columns):
                at = (y * _STRIP + x) * LANES
                above = load(cells, at - _STRIP * LANES)
                here = load(source, (y * width + left + x) * LANES)
                store(cells, at, here + splat(decay[y, left + x]) * above)
        for x in range(columns):
            at = ((height - 1) * _STRIP + x) * LANES
            store(source, ((height - 1) * width + left + x) * LANES, load(cells, at))
        for y in range(height - 2, -1, -1):
            for x in range(columns):
                at = (y * _STRIP + x) * LANES
                below = (y + 1) * width + left + x
                total = load(cells, at) + splat(decay[y + 1, left + x]) * load(source, below * LANES)
                store(source, (below - width) * LANES, total)
