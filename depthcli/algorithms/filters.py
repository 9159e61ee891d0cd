"""Filters of images and maps that several packages share, with the same bytes for any number of threads."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.core.maps import Floats, Image8, Mask
from depthcli.core.method import ConfigModel, Odd
from depthcli.kernels.jit import empty, helper, jit, run_bands, zeros

_BAND = 32  # rows per task
_DISC_GAP = 2.0  # neighbors at a discontinuity differ by more than this disparity, pixels


CORRELATED = 7
"""Side of the windows of :func:`correlation`, pixels; networks are trained with it."""


def local_moments(image: Floats, side: int) -> tuple[Floats, Floats]:
    """Return mean and variance in square windows of ``side`` pixels, reflected at the border; (H, W) float32 each."""
    mean = cv2.blur(image, (side, side))
    variance = np.maximum(cv2.blur(image * image, (side, side)) - mean * mean, 0)
    return np.asarray(mean, np.float32), np.asarray(variance, np.float32)


def local_range(values: Floats, side: int) -> Floats:
    """Return the largest minus the smallest value in square windows of ``side`` pixels, (H, W) float32."""
    window = np.ones((side, side), np.uint8)
    return np.asarray(cv2.dilate(values, window) - cv2.erode(values, window), np.float32)


def window_means(planes: Floats, side: int, out: Floats | None = None) -> Floats:
    """Return the means of square windows of (N, H, W) float32 planes, like cv2.blur, on all threads."""
    out = np.empty(planes.shape, np.float32) if out is None else out
    run_bands(_average, planes.shape[0] * -(-planes.shape[1] // _BAND), planes, side, out)
    return out


def correlation(image: Floats, moments: tuple[Floats, Floats], others: Floats) -> Floats:
    """Return the correlation of square windows of an (H, W) image with windows of ``others``, (N, H, W).

    Windows have a side of ``CORRELATED`` pixels. ``moments`` are the local mean and variance of ``image``. Variances
    are raised by 4 squared grey levels, so that noise does not correlate.
    """
    mean, square, product = (window_means(each, CORRELATED) for each in (others, others * others, image * others))
    run_bands(_correlate, mean.shape[1], mean, square, product, *moments)
    return product


@helper
def _mirrored(at, size):
    # Return the reflected index, like OpenCV's BORDER_REFLECT_101.
    while size > 1 and not 0 <= at < size:
        at = -at if at < 0 else 2 * (size - 1) - at
    return at if size > 1 else 0


@helper
def add(row, sums):
    """Add ``row`` to the flat ``sums``, element by element; ``row`` may be longer."""
    for i in range(sums.size):
        sums[i] += row[i]


@jit
def _average(begin, end, planes, side, out):
    # Column sums are updated from row to row of a band; row sums are computed for every row. Doubles, as in OpenCV.
    _, height, width = planes.shape
    bands, reach, share = -(-height // _BAND), side // 2, 1.0 / (side * side)
    for task in range(begin, end):
        n, top = task // bands, task % bands * _BAND
        sums, total = zeros(width + 2 * reach, np.float64), empty(width, np.float64)
        columns = sums[reach : reach + width]
        for v in range(top - reach, top + reach):
            add(planes[n, _mirrored(v, height)], columns)
        for y in range(top, min(top + _BAND, height)):
            add(planes[n, _mirrored(y + reach, height)], columns)
            for k in range(reach):
                sums[k] = columns[_mirrored(k - reach, width)]
                sums[reach + width + k] = columns[_mirrored(width + k, width)]
            for x in range(width):
                total[x] = sums[x]
            for k in range(1, side):
                add(sums[k : k + width], total)
            row, old = out[n, y], planes[n, _mirrored(y - reach, height)]
            for x in range(width):
                row[x] = total[x] * share
                columns[x] -= old[x]


@jit
def _correlate(begin, end, mean, square, product, other_mean, other_variance):
    # ``product`` becomes the correlation. One operation per loop: fused operations would round differently.
    count, _, width = mean.shape
    zero, noise = np.float32(0), np.float32(4)
    for y in range(begin, end):
        scratch = empty(width, np.float32)
        for n in range(count):
            m, s, p = mean[n, y], square[n, y], product[n, y]
            for x in range(width):
                scratch[x] = m[x] * other_mean[y, x]
            for x in range(width):
                p[x] -= scratch[x]
                scratch[x] = m[x] * m[x]
            for x in range(width):
                s[x] = max(s[x] - scratch[x], zero)
            for x in range(width):
                scratch[x] = np.sqrt((s[x] + noise) * (other_variance[y, x] + noise))
            for x in range(width):
                p[x] /= scratch[x]


def beside_steps(across: Mask, down: Mask) -> Mask:
    """Select the pixels, (H, W) bool, on both sides of steps between columns, (H, W - 1), or rows, (H - 1, W)."""
    selected = np.zeros((len(across), down.shape[1]), np.bool_)
    for step, pixels in ((across.T, selected.T), (down, selected)):
        pixels[1:] |= step
        pixels[:-1] |= step
    return selected


def discontinuity_mask(disparity: NDArray[np.floating[Any]], nonocc: Mask, known: Mask | None = None) -> Mask:
    """Return the visible pixels near a depth discontinuity, as in the ``disc`` masks of Middlebury v2.

    These are the pixels of ``nonocc`` (visible in both views) whose 9 x 9 window contains an occluded pixel, or a pixel
    whose disparity differs by more than 2 from a 4-neighbor's disparity. Only ``known`` pixels outside ``nonocc`` count
    as occluded; None: all pixels are known. Disparities are finite.
    """
    edge = ~nonocc if known is None else known & ~nonocc
    edge |= beside_steps(*(np.abs(np.diff(disparity, axis=axis)) > _DISC_GAP for axis in (1, 0)))
    near: Mask = cv2.dilate(edge.astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
    return near & nonocc


_LOCK = threading.Lock()
_USERS: list[int] = []  # one entry per active context: OpenCV's number of threads before the first one


@contextlib.contextmanager
def single_thread() -> Iterator[None]:
    """Let OpenCV use one thread within the context; several Python threads may use the context at the same time.

    The fast global smoother, and the WLS filter based on it, divide images into one stripe per thread and round
    differently at the ends of vectors, so that the last bits depend on the number of threads.
    """
    with _LOCK:
        _USERS.append(_USERS[0] if _USERS else cv2.getNumThreads())
        cv2.setNumThreads(1)
    try:
        yield
    finally:
        with _LOCK:
            before = _USERS.pop()
            if not _USERS:
                cv2.setNumThreads(before)


class JointBilateral(ConfigModel):
    """Filling with means of a window, weighted by distance and color similarity."""

    window: Odd = Field(21, ge=3, le=101, description="side of the window, pixels, odd")
    sigma_space: float = Field(5.0, gt=0, description="standard deviation of the weight by distance, pixels")
    sigma_color: float = Field(15.0, gt=0, description="standard deviation of the weight by color, grey levels")

    def fill(self, color: Image8, values: Floats) -> Floats:
        """Fill NaN with ``sum w v / sum w`` over the known values in a window, from the edges of gaps inwards.

        ``w = exp(-|p - q|^2 / 2 sigma_space^2 - |I_p - I_q|^2 / 2 sigma_color^2)`` for an (H, W, 3) image I. Filled
        values count as known in the next round. Pixels that no round can fill remain NaN.
        """
        offsets = np.arange(-(self.window // 2), self.window // 2 + 1)
        spatial = np.exp(-(offsets[:, None] ** 2 + offsets**2) / (2 * self.sigma_space**2)).astype(np.float32)
        likeness = np.exp(-np.arange(3 * 255**2 + 1) / (2 * self.sigma_color**2)).astype(np.float32)
        filled = values.copy()
        unknown = np.argwhere(np.isnan(filled))
        while unknown.size:
            means = np.empty(len(unknown), np.float32)
            run_bands(_bilateral_means, len(unknown), color, filled, unknown, spatial, likeness, means)
            reached = ~np.isnan(means)
            if not reached.any():
                break
            filled[tuple(unknown[reached].T)] = means[reached]
            unknown = unknown[~reached]
        return filled


@jit
def _bilateral_means(begin, end, color, values, pixels, spatial, likeness, means):
    height, width = values.shape
    reach = spatial.shape[0] // 2
    for n in range(begin, end):
        y, x = pixels[n]
        r, g, b = np.int32(color[y, x, 0]), np.int32(color[y, x, 1]), np.int32(color[y, x, 2])
        total, weights = 0.0, 0.0
        for v in range(max(y - reach, 0), min(y + reach + 1, height)):
            for u in range(max(x - reach, 0), min(x + reach + 1, width)):
                value = values[v, u]
                if np.isnan(value):
                    continue
                dr, dg, db = color[v, u, 0] - r, color[v, u, 1] - g, color[v, u, 2] - b
                weight = spatial[v - y + reach, u - x + reach] * likeness[dr * dr + dg * dg + db * db]
                total += weight * value
                weights += weight
        # If all colors differ, all weights underflow: leave the pixel to the next round, when closer pixels are known.
        means[n] = total / weights if weights > 1e-30 else np.nan
