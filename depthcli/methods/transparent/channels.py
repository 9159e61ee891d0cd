"""Color seen as an infrared camera would: weights of the channels, learned where the sensor knows the depth."""

from __future__ import annotations

import itertools

import cv2
import numpy as np
from numpy.typing import NDArray

GREY = (0.299, 0.587, 0.114)
_WINDOW = 15  # side of the window whose mean is taken off, pixels
_FEWEST = 500  # correspondences that are needed
_STRIDE = 7  # of the correspondences that are used; neighbors say the same


def learned_weights(
    color: NDArray[np.uint8], infrared: NDArray[np.uint8], disparity: NDArray[np.float32]
) -> tuple[float, float, float]:
    """Weights >= 0 that sum to 1, of the channels whose mix best follows the infrared image.

    Both are taken without their local mean, so that only structure counts; least squares without negative weights
    (Chiu et al., BMVC 2011: early fusion). Where the sensor knows too little, the weights of grey.

    Parameters
    ----------
    color : (H, W, 3) uint8, left view
    infrared : (H, W) uint8, right view
    disparity : (H, W) float32, what the sensor measured, pixels, NaN = unknown
    """
    rows, columns = np.nonzero(np.isfinite(disparity))
    matched = np.rint(columns - disparity[rows, columns]).astype(np.int64)
    inside = (matched >= 0) & (matched < color.shape[1])
    rows, columns, matched = (part[inside][::_STRIDE] for part in (rows, columns, matched))
    if rows.size * _STRIDE < _FEWEST:
        return GREY
    structure = _structure(color)[rows, columns].astype(np.float64)
    target = _structure(infrared)[rows, matched].astype(np.float64)
    found = nonnegative_least_squares(structure, target)
    total = float(found.sum())
    if total <= 0:
        return GREY
    red, green, blue = (float(w) / total for w in found)
    return red, green, blue


def mixed(color: NDArray[np.uint8], weights: tuple[float, ...]) -> NDArray[np.uint8]:
    """(H, W) uint8, the weighted sum of the channels."""
    mix = color.astype(np.float32) @ np.asarray(weights, np.float32)
    return np.clip(np.rint(mix), 0, 255).astype(np.uint8)


def nonnegative_least_squares(matrix: NDArray[np.float64], target: NDArray[np.float64]) -> NDArray[np.float64]:
    """x >= 0 that minimizes |A x - b|, for a few columns: the best of the solutions on every set of them."""
    count = matrix.shape[1]
    normal, right = matrix.T @ matrix, matrix.T @ target
    best, least = np.zeros(count), 0.0
    for size in range(1, count + 1):
        for chosen in itertools.combinations(range(count), size):
            part = np.ix_(chosen, chosen)
            values = np.linalg.lstsq(normal[part], right[list(chosen)], rcond=None)[0]
            if (values < 0).any():
                continue
            cost = float(values @ normal[part] @ values - 2 * values @ right[list(chosen)])
            if cost < least:
                best, least = np.zeros(count), cost
                best[list(chosen)] = values
    return best


def _structure(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    wide = image.astype(np.float32)
    return np.asarray(wide - cv2.blur(wide, (_WINDOW, _WINDOW)), np.float32)
