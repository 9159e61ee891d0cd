"""Radiometric adjustment: gains that make the grey levels of matches agree, and how well they then do."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.frames import Image
from depthcli.kernels.jit import jit, parallel_jit, prange
from depthcli.methods.stereo.adjustment.resampling import CELL

_LOCAL_SIGMA, _WIDE_SIGMA = 12.0, 30.0  # of the Gaussian means of cells, pixels of the reduced size
_OFFSET = np.float32(8.0)  # grey levels added on both sides of a ratio: noise dominates the ratio of darker pixels
_PRIOR_WEIGHT = 0.5  # of the mean that is one step wider, in matches per pixel
_MIN_WIDE_DENSITY, _MIN_LOCAL_DENSITY = np.float32(1e-3), np.float32(0.05)  # matches per pixel: keep the priors > 0
_MAX_RATIOS = (1.6, 1.2)  # between grey levels of a match, once by the global and once by the local gain
_GAIN_BOUNDS = (0.1, 10.0)
_MAX_MEDIAN_SAMPLES = 4096  # more do not change the median
_TRUST_PRIOR = np.float32(0.2)  # weight of the wider mean of differences, in matches per pixel
_HALF_TRUST = np.float32(6.0)  # grey levels: difference of right matches at which the trust is one half


def estimate_gains(disparity: NDArray[np.float32], left: Image, right: Image) -> NDArray[np.float32]:
    """Return the local ratio of the left to the right grey levels of matches.

    Means over matches around every cell, in which a wide mean is the prior of the local one, and the median ratio that
    of the wide one. Matches whose ratio is an outlier do not count.

    Parameters
    ----------
    disparity : (H, W) float32, NaN without a match
    left, right : (H, W, 3) uint8, the right one not multiplied by any gains

    Returns
    -------
    (ceil(H / 4), ceil(W / 4), 3) float32, cells of the right image
    """
    cells = tuple(-(-side // CELL) for side in disparity.shape)
    median = _median_gain(disparity, left, right)
    gains: NDArray[np.float32] = np.zeros((*cells, 3), np.float32) + median
    for max_ratio in _MAX_RATIOS:
        sums = np.zeros((3, *cells, 3), np.float32)
        sum_light(disparity, left, right, gains, np.float32(max_ratio), sums)
        wide, local = _means(sums)
        prior = _PRIOR_WEIGHT * wide[2] + _MIN_WIDE_DENSITY
        wide_gains = (wide[0] + prior * median * _OFFSET) / (wide[1] + prior * _OFFSET)
        prior = _PRIOR_WEIGHT * np.maximum(local[2], _MIN_LOCAL_DENSITY)
        gains = np.asarray((local[0] + prior * wide_gains * _OFFSET) / (local[1] + prior * _OFFSET), np.float32)
    return np.asarray(np.clip(gains, *_GAIN_BOUNDS), np.float32)


def light_trust(
    disparity: NDArray[np.float32], left: Image, right: Image, factor: int, shape: tuple[int, int]
) -> NDArray[np.uint8]:
    """Return how far the grey levels of corrected matches agree: (H, W) of the full ``shape``, 255 for "entirely".

    Parameters
    ----------
    disparity : (H, W) float32, NaN without a match
    left, right : (H, W, 3) uint8, the right one corrected
    factor : ratio of the full size to that of ``disparity``
    shape : (H, W) of the full size
    """
    sums = np.zeros((2, *(-(-side // CELL) for side in disparity.shape)), np.float32)
    sum_differences(disparity, left, right, sums)
    mean = sums[0].sum() / sums[1].sum()
    wide, local = _means(sums)
    wide_differences = (wide[0] + _TRUST_PRIOR * mean) / (wide[1] + _TRUST_PRIOR)
    differences = (local[0] + _TRUST_PRIOR * wide_differences) / (local[1] + _TRUST_PRIOR)
    trust = np.asarray(np.rint(255 / (1 + (differences / _HALF_TRUST) ** 2)), np.uint8)
    side = CELL * factor
    whole = cv2.resize(trust, (side * trust.shape[1], side * trust.shape[0]), interpolation=cv2.INTER_LINEAR)
    return np.ascontiguousarray(whole[: shape[0], : shape[1]], np.uint8)


def _median_gain(disparity: NDArray[np.float32], left: Image, right: Image) -> NDArray[np.float32]:
    y, x = np.nonzero(~np.isnan(disparity))
    sample = slice(None, None, 1 + y.size // _MAX_MEDIAN_SAMPLES)
    y, x = y[sample], x[sample]
    u = np.maximum(x - np.rint(disparity[y, x]).astype(np.int64), 0)
    return np.asarray(np.median((left[y, x] + _OFFSET) / (right[y, u] + _OFFSET), axis=0), np.float32)


def _means(sums: NDArray[np.float32]) -> list[list[NDArray[np.float32]]]:
    return [
        [
            np.asarray(cv2.GaussianBlur(grid, (0, 0), sigma / CELL, borderType=cv2.BORDER_REFLECT), np.float32)
            for grid in sums
        ]
        for sigma in (_WIDE_SIGMA, _LOCAL_SIGMA)
    ]


@jit
def _matching_column(x, disparity):
    return max(x - int(disparity + np.float32(0.5)), 0)


@parallel_jit
def sum_light(disparity, left, right, gains, max_ratio, sums):
    """Add left and right grey levels of matches, and their number, to ``sums`` (3, h, w, 3), per pixel of a cell.

    Cells are those of the right image. Saturated samples count like others: grey levels are to agree, even where they
    do not determine a gain.
    """
    height, width = disparity.shape
    share = np.float32(1 / CELL**2)
    for i in prange(sums.shape[1]):
        for y in range(i * CELL, min(height, (i + 1) * CELL)):
            for x in range(width):
                if np.isnan(disparity[y, x]):
                    continue
                u = _matching_column(x, disparity[y, x])
                j = u // CELL
                for c in range(3):
                    left_level, right_level = np.float32(left[y, x, c]), np.float32(right[y, u, c])
                    expected = (right_level + _OFFSET) * gains[i, j, c]
                    if left_level + _OFFSET < max_ratio * expected and expected < max_ratio * (left_level + _OFFSET):
                        sums[0, i, j, c] += share * left_level
                        sums[1, i, j, c] += share * right_level
                        sums[2, i, j, c] += share


@parallel_jit
def sum_differences(disparity, left, right, sums):
    """Add the mean difference of matches over the channels, and their number, to ``sums`` (2, h, w), per pixel of a
    cell of the left image.
    """
    height, width = disparity.shape
    share = np.float32(1 / CELL**2)
    for i in prange(sums.shape[1]):
        for y in range(i * CELL, min(height, (i + 1) * CELL)):
            for x in range(width):
                if np.isnan(disparity[y, x]):
                    continue
                u = _matching_column(x, disparity[y, x])
                sums[1, i, x // CELL] += share
                for c in range(3):
                    difference = abs(np.float32(left[y, x, c]) - np.float32(right[y, u, c]))
                    sums[0, i, x // CELL] += share * difference / np.float32(3)
