"""Pairs of a color camera and an infrared-like one, made from ordinary pairs.

The truth of the pair holds on: only the right picture's brightness changes, in a way that no global
curve undoes.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.io.formats.images import Image

# Of the model in :func:`infrared_like`, set by hand: red counts most, and the gain changes across the image.
_RGB_WEIGHTS = np.array([0.6, 0.3, 0.1], np.float32)
_GAMMA = 0.7
_GAIN_RANGE = (0.7, 1.3)
_NOISE_SIGMA = 4.0  # grey levels


def infrared_like(image: Image, seed: int = 0, speckles: float = 0.0) -> NDArray[np.uint8]:
    """Return what an infrared camera might have recorded: ``255 * (0.6 R + 0.3 G + 0.1 B) ** 0.7 * gain + noise``.

    The power is taken on the range [0, 1], so that black and white keep their places. The gain is a smooth
    field that fills [0.7, 1.3]; the noise is Gaussian with sigma 4 grey levels; the result is clipped.

    Parameters
    ----------
    image : (H, W, 3) RGB or (H, W) grey, uint8 or uint16
    seed : of the gain field, the noise and the dots
    speckles : share of the pixels that get a bright projected dot, in [0, 1]; a depth camera's pattern

    Returns
    -------
    (H, W) uint8

    Raises
    ------
    ValueError
        For a speckle share outside [0, 1].
    """
    if not 0 <= speckles <= 1:
        raise ValueError(f"speckles is a share in [0, 1], got {speckles}")
    rng = np.random.default_rng([seed, 0x17])
    top = np.float32(np.iinfo(image.dtype).max)
    light = image.astype(np.float32) / top
    if light.ndim == 3:
        light = light @ _RGB_WEIGHTS
    height, width = light.shape
    result = 255 * np.power(light, np.float32(_GAMMA)) * _gain_field(rng, height, width)
    if speckles > 0:
        dots = (rng.random((height, width)) < speckles).astype(np.float32)
        result += 400 * cv2.GaussianBlur(dots, (0, 0), 0.7)
    result += _NOISE_SIGMA * rng.standard_normal((height, width), np.float32)
    return np.asarray(np.clip(np.rint(result), 0, 255), np.uint8)


def _gain_field(rng: np.random.Generator, height: int, width: int) -> NDArray[np.float32]:
    """Smooth (H, W) field whose extremes are the two ends of the gain's range."""
    grid = rng.standard_normal((5, 6)).astype(np.float32)
    field = cv2.resize(grid, (width, height), interpolation=cv2.INTER_CUBIC)
    low, high = float(field.min()), float(field.max())
    scaled = (field - low) / max(high - low, 1e-6)
    return (_GAIN_RANGE[0] + (_GAIN_RANGE[1] - _GAIN_RANGE[0]) * scaled).astype(np.float32)


def cross_modal_pair(
    left: Image, right: Image, seed: int = 0, speckles: float = 0.0
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return the left picture as grey, the right picture as infrared.

    Parameters
    ----------
    left, right : (H, W, 3) RGB or (H, W) grey, uint8 or uint16, a rectified pair
    seed, speckles : as for :func:`infrared_like`

    Returns
    -------
    left, right : (H, W) uint8
    """
    grey = left if left.ndim == 2 else cv2.cvtColor(left, cv2.COLOR_RGB2GRAY)
    if grey.dtype == np.uint16:
        grey = ((grey.astype(np.uint32) + 128) // 257).astype(np.uint8)
    return np.asarray(grey, np.uint8), infrared_like(right, seed, speckles)
