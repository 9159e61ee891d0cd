"""Color mixed to resemble an infrared image, with weights that are learned from pixels of known disparity."""

from __future__ import annotations

import itertools

import cv2
import numpy as np

from depthcli.core.arrays import Floats, Image8

Weights = tuple[float, float, float]
"""Of the red, green and blue channel."""
GREY: Weights = (0.299, 0.587, 0.114)
"""Weights of red, green and blue in the luma of ITU-R BT.601."""
# Values that the presets were published with; nothing in the repository varies them.
_MEAN_WINDOW = 15  # side of the window whose mean is subtracted, pixels
_MIN_CORRESPONDENCES = 500  # pixels of known disparity that weights are fitted to; with fewer, those of grey
_STRIDE = 7  # every so many-th correspondence is used: neighbors are alike


def learned_weights(color: Image8, infrared: Image8, disparity: Floats) -> Weights:
    """Fit the weights of the color channels whose mix best follows the infrared image, >= 0 and with sum 1.

    Both are taken without their local mean, so that only structure counts; least squares without negative weights
    (Chiu et al., BMVC 2011: early fusion). Where the sensor, whose ``disparity`` is given, knows too few pixels, the
    weights of grey.
    """
    rows, columns = np.nonzero(np.isfinite(disparity))
    matched = np.rint(columns - disparity[rows, columns]).astype(np.int64)
    inside = (matched >= 0) & (matched < color.shape[1])
    rows, columns, matched = (part[inside][::_STRIDE] for part in (rows, columns, matched))
    if rows.size * _STRIDE < _MIN_CORRESPONDENCES:
        return GREY
    structure = _structure(color)[rows, columns].astype(np.float64)
    target = _structure(infrared)[rows, matched].astype(np.float64)
    # Least squares over weights >= 0: the best of the solutions on every subset of the channels.
    normal, right = structure.T @ structure, structure.T @ target
    weights, lowest = np.zeros(3), 0.0
    for subset in itertools.chain(*(itertools.combinations(range(3), n) for n in (1, 2, 3))):
        chosen = list(subset)
        part = normal[np.ix_(chosen, chosen)]
        values = np.linalg.lstsq(part, right[chosen], rcond=None)[0]
        cost = float(values @ part @ values - 2 * values @ right[chosen])
        if (values >= 0).all() and cost < lowest:
            weights, lowest = np.zeros(3), cost
            weights[chosen] = values
    total = float(weights.sum())
    if total <= 0:
        return GREY
    red, green, blue = (float(w) / total for w in weights)
    return red, green, blue


def mix_channels(color: Image8, weights: Weights) -> Image8:
    """Return the weighted sum of the channels of (H, W, 3) ``color``, (H, W) uint8."""
    mix = color.astype(np.float32) @ np.asarray(weights, np.float32)
    return np.clip(np.rint(mix), 0, 255).astype(np.uint8)


def _structure(image: Image8) -> Floats:
    wide = image.astype(np.float32)
    return np.asarray(wide - cv2.blur(wide, (_MEAN_WINDOW, _MEAN_WINDOW)), np.float32)
