"""Sensor noise: how strong it is beside the contrast of a pair, and its removal before matching.

Costs of single pixels do not say much about a pair taken in the dark: most of the differences that they measure are
noise. Means over pixels of similar color do, and both images can be averaged before any measure compares them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.frames import Image, StereoPair

_BLOCK, _REGION = 8, 32  # sides of the blocks that noise and of the regions that contrast is measured in, pixels
_FLAT_PERCENTILE = 10  # blocks with less energy: nearly all of it is noise
_SECOND_DIFFERENCE = np.outer((1, -2, 1), (1, -2, 1)).astype(np.float32) / 6  # keeps the variance of white noise
_TEXTURE_GROWTH = 1.44  # ratio of the energies of texture, halved over full size; that of white noise is 1/4
_ROUNDING_NOISE = 0.25  # standard deviation, levels: never less is assumed
_NOISY, _CLEAN = 8.0, 14.0  # contrast over noise: the whole effect and none
_RADIUS = 3  # of the filter's window, pixels
_NOISE_LIMIT = 3.0  # standard deviations: variance of a window that is half averaged away
_BRIGHT_PERCENTILE, _BRIGHT = 90, 0.55  # where that percentile of the levels is raised to, parts of the range
_MAX_GAIN = 24.0
_STRIP = 512  # rows that are filtered at a time


def denoised(pair: StereoPair) -> StereoPair:
    """Return a pair without most of its noise, and brightened where it is dark; a pair of little noise as it is.

    Both images are averaged by a guided filter (He, Sun, Tang, TPAMI 2013) of 7 x 7 pixels whose guide is the mean of
    the channels, with an epsilon of (3 deviations of the noise) squared. A dark pair is brightened by a curve
    ``g v / (1 + (g - 1) v)``, v in [0, 1], that raises the 90th percentile to 0.55, as measures compare levels with
    constants. The result has 16 bits: rounding would bring noise back. Between a contrast over noise of 14 and 8 the
    effect grows from none to the whole.
    """
    images = pair.clamped
    deviations, contrasts = zip(*map(noise_level, images), strict=True)
    deviation, contrast = max(deviations), min(contrasts)
    share = float(np.clip((_CLEAN - contrast) / (_CLEAN - _NOISY), 0, 1))
    if share == 0:
        return pair
    bright = max(float(np.percentile(_level(image), _BRIGHT_PERCENTILE)) for image in images) / pair.top
    gain = _BRIGHT * (1 - bright) / max(bright * (1 - _BRIGHT), 1e-6)
    gain = 1 + share * (float(np.clip(gain, 1, _MAX_GAIN)) - 1)
    epsilon = (_NOISE_LIMIT * share * deviation) ** 2
    left, right = (_filtered(image, epsilon, share, gain, pair.top) for image in images)
    return replace(pair, left=left, right=right, bits=None)


def noise_level(image: Image) -> tuple[float, float]:
    """Return the standard deviation of an image's noise, levels, and the contrast over it, by the flattest blocks.

    The contrast is the typical standard deviation within 32 x 32 pixels. Noise is white: averaged over 2 x 2 pixels it
    has a quarter of the energy, while fine texture, which may fill an image as evenly as noise, does not lose any.
    """
    level = _level(image)
    full = _flat_energy(level)
    half = _flat_energy(_block_means(level, 2))
    variance = np.clip((_TEXTURE_GROWTH * full - half) / (_TEXTURE_GROWTH - 0.25), 0, full)
    deviation = max(float(np.sqrt(variance)), _ROUNDING_NOISE)
    spread = _block_means(level * level, _REGION) - _block_means(level, _REGION) ** 2
    return deviation, float(np.sqrt(max(np.median(spread), 0))) / deviation


def _level(image: Image) -> NDArray[np.float32]:
    # The mean of the channels.
    if image.ndim == 2:
        return image.astype(np.float32)
    return cast(NDArray[np.float32], cv2.transform(image.astype(np.float32), np.full((1, 3), 1 / 3, np.float32)))


def _flat_energy(level: NDArray[np.float32]) -> float:
    details = cv2.filter2D(level, cv2.CV_32F, _SECOND_DIFFERENCE, borderType=cv2.BORDER_REFLECT)
    return float(np.percentile(_block_means(details * details, _BLOCK), _FLAT_PERCENTILE))


def _block_means(values: NDArray[np.float32], side: int) -> NDArray[np.float32]:
    # Means of whole blocks, at least of one.
    height, width = (max(1, n // side) for n in values.shape)
    part = values[: height * side, : width * side]
    return np.asarray(cv2.resize(part, (width, height), interpolation=cv2.INTER_AREA), np.float32)


def _filtered(image: Image, epsilon: float, share: float, gain: float, top: int) -> NDArray[np.uint16]:
    result = np.empty(image.shape, np.uint16)
    margin = 2 * _RADIUS
    for y in range(0, image.shape[0], _STRIP):
        first = max(0, y - margin)
        part = image[first : y + _STRIP + margin]
        guide, values = _level(part), part.astype(np.float32)
        averaged = cv2.ximgproc.guidedFilter(guide, values, _RADIUS, epsilon)
        if image.ndim == 3 and share < 1:
            # A weak filter must not take away colors that the guide does not have: then all channels change alike.
            alike = values + (cv2.ximgproc.guidedFilter(guide, guide, _RADIUS, epsilon) - guide)[..., None]
            averaged = alike + np.float32(share) * (averaged - alike)
        values = np.clip(averaged[y - first :][:_STRIP] / np.float32(top), 0, 1)
        values = gain * values / (1 + (gain - 1) * values)
        result[y : y + _STRIP] = np.rint(values * np.float32(65535))
    return result
