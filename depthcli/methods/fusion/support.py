"""Supports: the pixels around a pixel that vote for it, weighted by color or all alike, and sums over them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.kernels.jit import jit, parallel_jit, prange

BLOCK_DEPTH = 16
"""Disparities, or maps, that a support sums at a time; the loops of its kernels are written for this number."""
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
            cells[y * 128 : y * 128 + columns * 16] = source
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
            target[:] = cells[y * 128 : y * 128 + columns * 16]
