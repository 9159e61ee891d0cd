"""What makes color and infrared images comparable: a mix of the color channels, and costs weighted by structure."""

from __future__ import annotations

import itertools

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.filters import local_moments
from depthcli.core import memory
from depthcli.kernels.jit import parallel_jit, prange
from depthcli.methods.stereo.volume import CostVolume

GREY = (0.299, 0.587, 0.114)
"""Weights of red, green and blue in the luma of ITU-R BT.601."""
# Values that the presets were published with; nothing in the repository varies them.
_MEAN_WINDOW = 15  # side of the window whose mean is subtracted, pixels
_MIN_CORRESPONDENCES = 500  # pixels of known disparity that weights are fitted to; with fewer, those of grey
_STRIDE = 7  # every so many-th correspondence is used: neighbors are alike


def learned_weights(
    color: NDArray[np.uint8], infrared: NDArray[np.uint8], disparity: NDArray[np.float32]
) -> tuple[float, float, float]:
    """Fit the weights of the color channels whose mix best follows the infrared image, >= 0 and with sum 1.

    Both are taken without their local mean, so that only structure counts; least squares without negative weights
    (Chiu et al., BMVC 2011: early fusion). Where the sensor knows too few pixels, the weights of grey.

    Parameters
    ----------
    color : (H, W, 3) uint8, left view
    infrared : (H, W) uint8, right view
    disparity : (H, W) float32, the sensor's, pixels, NaN = unknown
    """
    rows, columns = np.nonzero(np.isfinite(disparity))
    matched = np.rint(columns - disparity[rows, columns]).astype(np.int64)
    inside = (matched >= 0) & (matched < color.shape[1])
    rows, columns, matched = (part[inside][::_STRIDE] for part in (rows, columns, matched))
    if rows.size * _STRIDE < _MIN_CORRESPONDENCES:
        return GREY
    structure = _structure(color)[rows, columns].astype(np.float64)
    target = _structure(infrared)[rows, matched].astype(np.float64)
    weights = solve_nnls(structure, target)
    total = float(weights.sum())
    if total <= 0:
        return GREY
    red, green, blue = (float(w) / total for w in weights)
    return red, green, blue


def mix_channels(color: NDArray[np.uint8], weights: tuple[float, ...]) -> NDArray[np.uint8]:
    """Return the weighted sum of the channels of (H, W, 3) ``color``, (H, W) uint8."""
    mix = color.astype(np.float32) @ np.asarray(weights, np.float32)
    return np.clip(np.rint(mix), 0, 255).astype(np.uint8)


def solve_nnls(matrix: NDArray[np.float64], target: NDArray[np.float64]) -> NDArray[np.float64]:
    """Minimize |A x - b| over x >= 0 for a few columns, by trying the solution on every subset of them."""
    count = matrix.shape[1]
    normal, right = matrix.T @ matrix, matrix.T @ target
    best, lowest = np.zeros(count), 0.0
    for subset in itertools.chain(*(itertools.combinations(range(count), n) for n in range(1, count + 1))):
        chosen = list(subset)
        part = normal[np.ix_(chosen, chosen)]
        values = np.linalg.lstsq(part, right[chosen], rcond=None)[0]
        cost = float(values @ part @ values - 2 * values @ right[chosen])
        if (values >= 0).all() and cost < lowest:
            best, lowest = np.zeros(count), cost
            best[chosen] = values
    return best


def _structure(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    wide = image.astype(np.float32)
    return np.asarray(wide - cv2.blur(wide, (_MEAN_WINDOW, _MEAN_WINDOW)), np.float32)


def local_deviation(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Compute the standard deviation of grey levels in 9 x 9, (H, W) float32."""
    return np.asarray(np.sqrt(local_moments(image.astype(np.float32), 9)[1]), np.float32)


def faded_costs(
    volume: CostVolume, left: NDArray[np.uint8], right: NDArray[np.uint8], structure_threshold: float
) -> CostVolume:
    """Fade costs towards the pixel's mean cost as far as one of the two windows lacks structure.

    Order, rank and correlation of a flat window are those of its noise, and saturated windows are all alike: such
    costs would outweigh those of the few pixels at the outlines.

    Parameters
    ----------
    volume : (H, W, D) uint8 or uint16
    left, right : (H, W) uint8
    structure_threshold : standard deviation in 9 x 9 from which on costs are kept, grey levels, > 0

    Returns
    -------
    CostVolume
        Of the same scale, uint16.
    """
    shares = [
        np.minimum(local_deviation(image) / np.float32(structure_threshold), np.float32(1)) for image in (left, right)
    ]
    out: NDArray[np.uint16] = memory.empty(volume.costs.shape, np.uint16)
    _fade(volume.costs, shares[0], shares[1], out)
    return CostVolume(out, volume.scale)


def cost_at(volume: CostVolume, disparity: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the lower of the costs beside a disparity, (H, W) float32, in units of the measure; NaN = unknown.

    Parameters
    ----------
    disparity : (H, W) float32, pixels; clipped to the range of the volume
    """
    max_disparity = np.float32(volume.n_disparities - 1)
    low = np.floor(np.clip(np.nan_to_num(disparity), 0, max_disparity)).astype(np.int64)
    rows, columns = np.ogrid[: low.shape[0], : low.shape[1]]
    beside = [volume.costs[rows, columns, np.minimum(low + step, volume.n_disparities - 1)] for step in (0, 1)]
    costs = np.minimum(*beside).astype(np.float32) / np.float32(volume.scale)
    return np.where(np.isfinite(disparity), costs, np.float32(np.nan))


def mean_cost(volume: CostVolume) -> NDArray[np.float32]:
    """Return the mean cost of a pixel's disparities, (H, W) float32, in units of the measure."""
    return np.asarray(volume.costs.mean(axis=2, dtype=np.float32) / np.float32(volume.scale), np.float32)


@parallel_jit
def _fade(costs, left, right, out):
    height, width, n_disparities = costs.shape
    half = np.float32(0.5)
    for y in prange(height):
        # Mirrored, so that a pixel's right shares run with its disparities; 1 outside the image.
        mirror = np.ones(width + n_disparities, np.float32)
        for x in range(width):
            mirror[width - 1 - x] = right[y, x]
        for x in range(width):
            source, target = costs[y, x], out[y, x]
            shares = mirror[width - 1 - x : width - 1 - x + n_disparities]
            total = np.uint32(0)
            for i in range(source.size):
                total += np.uint32(source[i])
            mean = np.float32(total) / np.float32(source.size)
            own = left[y, x]
            for i in range(source.size):
                share = min(own, shares[i])
                target[i] = np.uint16(np.int32(mean + share * (np.float32(source[i]) - mean) + half))
