"""Sensor noise: its strength relative to the contrast of a pair, and its removal before matching.

In a pair taken in the dark, costs of single pixels measure mostly noise. Means over pixels of similar color measure
texture, so both images are averaged before any cost compares them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.frames import Image, StereoPair
from depthcli.core.maps import Floats

_BLOCK, _REGION = 8, 32  # sides of the blocks that measure noise and of the regions that measure contrast, pixels
_FLAT_PERCENTILE = 10  # blocks with less energy contain hardly anything but noise
_SECOND_DIFFERENCE = np.outer((1, -2, 1), (1, -2, 1)).astype(np.float32) / 6  # keeps the variance of white noise
_TEXTURE_GROWTH = 1.44  # energy of texture at half size over its energy at full size; white noise has 1/4
_ROUNDING_NOISE = 0.25  # smallest standard deviation that is assumed, levels
_NOISY, _CLEAN = 8.0, 14.0  # contrast over noise: full effect below, no effect above
_RADII = 3, 10  # of the filter's window, pixels: for white noise, maximum
_DARK = 0.15  # a pair is dark if the 90th percentile is below this part of the range; its noise may span several pixels
_SHARED_NOISE = 1.5  # 4 x deviation of 4 x 4 means, over deviation of pixels; of noise with grains of 1 to 2 pixels
_MATCHED, _ALIKE = 40, (0.7, 0.85)  # percentile of energy of the blocks to be matched; correlation of noise, of texture
_DIFFERING, _BURIED = 0.5, 3.5  # a dark pair is whitened above this share of noise and below this contrast over noise
_SPECTRUM, _SPREAD = 32, 0.12  # side of a spectrum's blocks, pixels; deviation after whitening, parts of the range
_ROUNDING_POWER, _MAX_BLOCKS = 1 / 36, 2048  # rounding noise of the mean of three channels; most blocks of a spectrum
_WHITENED_RADIUS = 5  # pixels; chosen on generated scenes and on scenes of 2005, _BURIED also on a KITTI frame
_NOISE_LIMIT = 3.0  # standard deviations of the noise: a window with this deviation is averaged by half
_BRIGHT_PERCENTILE, _BRIGHT = 90, 0.55  # this percentile of the levels is raised to this part of the range
_MAX_GAIN = 24.0
_STRIP = 512  # rows filtered at a time


def denoised(pair: StereoPair) -> StereoPair:
    """Return a pair without most of its noise, and brighter if it is dark. A pair with little noise is not changed.

    A guided filter averages both images (He, Sun, Tang, TPAMI 2013). Its guide is the mean of the channels, its epsilon
    is (3 deviations of the noise) squared. Its window has 7 x 7 pixels, or more if neighbors share the noise. If the
    90th percentile of the levels is below 0.55, a curve ``g v / (1 + (g - 1) v)``, v in [0, 1], raises it, because
    costs compare levels with constants. The result has 16 bits, because rounding would bring noise back. The effect
    grows from none at a contrast over noise of 14 to full at 8. If a dark pair has noise as coarse as texture,
    averaging would remove the texture, so the pair is whitened instead: see :func:`whitening`.
    """
    images = pair.clamped
    levels = [_level(image) for image in images]
    rest = 1 - _BRIGHT_PERCENTILE / 100
    is_dark = all(np.count_nonzero(level >= _DARK * pair.top) < rest * level.size for level in levels)
    differing = _differing(*levels) if is_dark else 0.0
    if differing > _DIFFERING and (found := whitening(levels)) is not None:
        kernel, deviation = found
        mean = np.float32(np.mean(levels))
        left, right = (_whitened(image, mean, kernel, (_NOISE_LIMIT * deviation) ** 2) for image in images)
        return replace(pair, left=left, right=right, bits=None)
    deviations, contrasts, radii = zip(*(noise_level(level, differing) for level in levels), strict=True)
    deviation, contrast = max(deviations), min(contrasts)
    share = float(np.clip((_CLEAN - contrast) / (_CLEAN - _NOISY), 0, 1))
    if share == 0:
        return pair
    bright = max(float(np.percentile(level, _BRIGHT_PERCENTILE)) for level in levels) / pair.top
    gain = _BRIGHT * (1 - bright) / max(bright * (1 - _BRIGHT), 1e-6)
    gain = 1 + share * (float(np.clip(gain, 1, _MAX_GAIN)) - 1)
    epsilon = (_NOISE_LIMIT * share * deviation) ** 2
    left, right = (_filtered(image, max(radii), epsilon, share, gain, pair.top) for image in images)
    return replace(pair, left=left, right=right, bits=None)


def noise_level(level: Floats, differing: float = 0.0) -> tuple[float, float, int]:
    """Return the standard deviation of an image's noise (levels), the contrast over it, and the radius to average over.

    The contrast is the median standard deviation within 32 x 32 pixels. White noise averaged over 2 x 2 pixels keeps a
    quarter of its energy; fine texture, which may fill an image as evenly, loses none. If a camera smooths or
    compresses, neighbors share noise. It shows in means over 4 x 4 pixels, as texture does: ``differing`` is the share
    of noise in them, 0 .. 1. The radius (pixels) grows with the size of the noise's grains.
    """
    half = _block_means(level, 2)
    full, two = _flat_energy(level), _flat_energy(half)
    variance = np.clip((_TEXTURE_GROWTH * full - two) / (_TEXTURE_GROWTH - 0.25), 0, full)
    deviation, radius = max(float(np.sqrt(variance)), _ROUNDING_NOISE), _RADII[0]
    if differing and two > 0:
        four = _flat_energy(_block_means(half, 2))
        more = 4 * math.sqrt(four) / _SHARED_NOISE - deviation
        if more > 0:
            deviation += differing * more
            radius = min(max(round(6 * math.sqrt(four / two)) - 1, radius), _RADII[1])
    spread = _block_means(level * level, _REGION) - _block_means(level, _REGION) ** 2
    return deviation, float(np.sqrt(max(np.median(spread), 0))) / deviation, radius


def whitening(levels: Sequence[Floats]) -> tuple[Floats, float] | None:
    """Return a filter for images in strong noise of any spectrum, (31, 31), and the deviation of the noise after it.

    Its gain at a frequency is ``sqrt(S) / N`` with the power S of texture and N of noise: Eckart's filter (Knapp,
    Carter, The generalized correlation method for estimation of time delay, TASSP 1976), after which weak signals stand
    out most. N is the power of the flattest blocks at a distance from frequency 0, and S is the rest of the mean power.
    Return None if the images are smaller than a block, have no texture, or have enough contrast for averaging.
    """
    n = _SPECTRUM
    if min(levels[0].shape) < n:
        return None
    column, row = np.meshgrid(*2 * [np.minimum(np.arange(n), n - np.arange(n))])
    ring = np.minimum(np.rint(np.hypot(row, column)).astype(int), n // 2).ravel()
    size = np.bincount(ring)
    window = np.outer(*2 * [np.sin(np.pi * np.arange(n) / n) ** 2]) * (8 / 3)  # keeps the power
    spectra = []
    for level in levels:
        height, width = (side // n for side in level.shape)
        blocks = level[: height * n, : width * n].reshape(height, n, width, n).swapaxes(1, 2).reshape(-1, n, n)
        blocks = blocks[:: -(-len(blocks) // _MAX_BLOCKS)]
        blocks = (blocks - blocks.mean(axis=(1, 2), keepdims=True)) * window
        power = (np.abs(np.fft.fft2(blocks)) ** 2 / n**2).reshape(-1, n * n)
        rings = np.stack([np.bincount(ring, one) for one in power]) / size
        spectra.append((np.percentile(rings, _FLAT_PERCENTILE, axis=0), rings.mean(axis=0), np.median(rings, axis=0)))
    noise, total, typical = np.mean(spectra, axis=0)
    noise = np.maximum(noise, _ROUNDING_POWER)
    share = size / n**2
    share[0] = 0  # the mean
    if typical @ share > _BURIED**2 * (noise @ share):
        return None
    gain = np.sqrt(np.maximum(total - noise, 1e-3 * total)) / noise
    gain[0] = gain[1]
    spread = float(np.sqrt((total * gain**2) @ share))
    if spread == 0:
        return None
    gain *= _SPREAD / spread
    kernel = np.fft.fftshift(np.fft.ifft2(gain[ring].reshape(n, n)).real)[1:, 1:]
    return kernel.astype(np.float32), float(np.sqrt((noise * gain**2) @ share))


def _whitened(image: Image, mean: np.float32, kernel: Floats, epsilon: float) -> NDArray[np.uint16]:
    result = np.empty(image.shape, np.uint16)
    margin = len(kernel) // 2 + 2 * _WHITENED_RADIUS
    for y in range(0, image.shape[0], _STRIP):
        first = max(0, y - margin)
        part = image[first : y + _STRIP + margin].astype(np.float32) - mean
        values = cv2.filter2D(part, cv2.CV_32F, kernel, borderType=cv2.BORDER_REFLECT)
        values = cv2.ximgproc.guidedFilter(_level(values), values, _WHITENED_RADIUS, epsilon)[y - first :][:_STRIP]
        result[y : y + _STRIP] = np.rint(65535 * np.clip(values + np.float32(0.5), 0, 1))
    return result


def _differing(left: Floats, right: Floats) -> float:
    # How much means over 4 x 4 pixels differ between the views, 0 .. 1. Texture, unlike noise, has a match in the row.
    left, right = (_block_means(level, 4) for level in (left, right))
    energy = _block_means(_details(left), _BLOCK)
    found = []
    for row, column in np.argwhere((energy > 0) & (energy <= np.percentile(energy, _MATCHED))) * _BLOCK:
        block, strip = (v[row : row + _BLOCK, : column + _BLOCK] for v in (left, right))
        found.append(float(cv2.matchTemplate(strip, block[:, column:], cv2.TM_CCOEFF_NORMED).max()))
    if not found:
        return 0.0
    noise, texture = _ALIKE
    return min(max((texture - float(np.median(found))) / (texture - noise), 0.0), 1.0)


def _level(image: NDArray[Any]) -> Floats:
    # The mean of the channels.
    if image.ndim == 2:
        return image.astype(np.float32)
    return cast(Floats, cv2.transform(image.astype(np.float32), np.full((1, 3), 1 / 3, np.float32)))


def _details(level: Floats) -> Floats:
    details = cv2.filter2D(level, cv2.CV_32F, _SECOND_DIFFERENCE, borderType=cv2.BORDER_REFLECT)
    return np.asarray(details * details, np.float32)


def _flat_energy(level: Floats) -> float:
    return float(np.percentile(_block_means(_details(level), _BLOCK), _FLAT_PERCENTILE))


def _block_means(values: Floats, side: int) -> Floats:
    # Means of whole blocks, at least one block a side.
    height, width = (max(1, n // side) for n in values.shape)
    part = values[: height * side, : width * side]
    return np.asarray(cv2.resize(part, (width, height), interpolation=cv2.INTER_AREA), np.float32)


def _filtered(image: Image, radius: int, epsilon: float, share: float, gain: float, top: int) -> NDArray[np.uint16]:
    result = np.empty(image.shape, np.uint16)
    margin = 2 * radius
    for y in range(0, image.shape[0], _STRIP):
        first = max(0, y - margin)
        part = image[first : y + _STRIP + margin]
        guide, values = _level(part), part.astype(np.float32)
        averaged = cv2.ximgproc.guidedFilter(guide, values, radius, epsilon)
        if image.ndim == 3 and share < 1:
            # A weak filter must keep colors that the guide does not have, so it changes all channels alike.
            alike = values + (cv2.ximgproc.guidedFilter(guide, guide, radius, epsilon) - guide)[..., None]
            averaged = alike + np.float32(share) * (averaged - alike)
        values = np.clip(averaged[y - first :][:_STRIP] / np.float32(top), 0, 1)
        values = gain * values / (1 + (gain - 1) * values)
        result[y : y + _STRIP] = np.rint(values * np.float32(65535))
    return result
