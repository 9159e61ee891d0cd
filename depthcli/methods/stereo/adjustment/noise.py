"""Sensor noise: how strong it is beside the contrast of a pair, and its removal before matching.

Costs of single pixels are of little use for a pair taken in the dark: most of the differences that they measure are
noise. Means over pixels of similar color do, and both images can be averaged before any measure compares them.
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
from depthcli.kernels.jit import jit, run_bands

_BLOCK, _REGION = 8, 32  # sides of the blocks that noise and of the regions that contrast is measured in, pixels
_FLAT_PERCENTILE = 10  # blocks with less energy: nearly all of it is noise
_SECOND_DIFFERENCE = np.outer((1, -2, 1), (1, -2, 1)).astype(np.float32) / 6  # keeps the variance of white noise
_TEXTURE_GROWTH = 1.44  # ratio of the energies of texture, halved over full size; that of white noise is 1/4
_ROUNDING_NOISE = 0.25  # standard deviation, levels: never less is assumed
_NOISY, _CLEAN = 8.0, 14.0  # contrast over noise: the whole effect and none
_RADII = 3, 10  # of the filter's window, pixels: for white noise, at most
_DARK = 0.15  # that percentile, parts of the range, below which noise may be of several pixels' size
_SHARED_NOISE = 1.5  # 4 times the deviation of means over 4 x 4 pixels, over that of pixels; noise of 1 to 2 pixels
_MATCHED, _ALIKE = 40, (0.7, 0.85)  # percentile of energy of blocks that are matched; correlation of noise, of texture
_DIFFERING, _BURIED = 0.5, 3.5  # share of noise, and contrast over noise: from and up to which a dark pair is whitened
_SPECTRUM, _SPREAD = 32, 0.12  # side of the blocks of a spectrum; deviation after whitening, parts of the range
_ROUNDING_POWER, _MAX_BLOCKS = 1 / 36, 2048  # of the mean of three rounded channels; blocks that a spectrum is made of
_WHITENED_RADIUS = 5  # chosen on generated scenes and those of 2005, _BURIED on a KITTI frame, too
_NOISE_LIMIT = 3.0  # standard deviations: variance of a window that is half averaged away
_BRIGHT_PERCENTILE, _BRIGHT = 90, 0.55  # where that percentile of the levels is raised to, parts of the range
_MAX_GAIN = 24.0
_STRIP = 512  # rows that are filtered at a time


def denoised(pair: StereoPair) -> StereoPair:
    """Return a pair without most of its noise, and brightened where it is dark; a pair of little noise as it is.

    Both images are averaged by a guided filter (He, Sun, Tang, TPAMI 2013) whose guide is the mean of the channels,
    with an epsilon of (3 deviations of the noise) squared. Its window has 7 x 7 pixels, more if neighbors share the
    noise. A dark pair is brightened by a curve ``g v / (1 + (g - 1) v)``, v in [0, 1], that raises the 90th percentile
    to 0.55, as measures compare levels with constants. The result has 16 bits: rounding would bring noise back. Between
    a contrast over noise of 14 and 8 the effect grows from none to the whole. A dark pair in noise as coarse as texture
    is whitened, see :func:`whitening`: averaging would take away the texture.
    """
    images = pair.clamped
    if _are_clean(images, pair.top):
        return pair
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


def _are_clean(images: tuple[Image, Image], top: int) -> bool:
    # Whether the contrast of both images is above ``_CLEAN``, and one of them is not dark, by bounds that are quick to
    # compute and hold for most pairs: all energy counts as noise, and a dark image has a small mean.
    if min(images[0].shape[:2]) < _REGION:
        return False
    means = []
    for image in images:
        height, width = (side // _REGION for side in image.shape[:2])
        blocks = np.empty((3, *(side // _BLOCK for side in image.shape[:2])), np.float32)
        run_bands(block_means, blocks.shape[1], image.reshape(*image.shape[:2], -1), blocks)
        n = _REGION // _BLOCK
        regions = blocks[1:, : height * n, : width * n].reshape(2, height, n, width, n).mean(axis=(2, 4))
        spread = np.sort((1 - 1e-5) * regions[1] - regions[0] ** 2, axis=None)  # less by more than rounding errors
        energy = np.sort(blocks[0], axis=None)
        noise = max(1.01 * energy[math.ceil(_FLAT_PERCENTILE / 100 * (energy.size - 1))], _ROUNDING_NOISE**2)
        if spread[(spread.size - 1) // 2] < _CLEAN**2 * noise:
            return False
        means.append(regions[0].mean())
    bright = 1 - _BRIGHT_PERCENTILE / 100
    return bool(max(means) > 1.01 * (bright + (1 - bright) * _DARK) * top)


@jit
def block_means(begin, end, image, means):
    """Write means over blocks of 8 x 8 pixels of an (H, W, C) ``image`` to ``means``, (3, H // 8, W // 8) float32.

    They are of the squared second differences of levels, the levels, and their squares; see :func:`noise_level`. A
    level is the mean of a pixel's channels.
    """
    height, width, channels = image.shape
    for i in range(begin, end):
        sums = np.zeros((3, width), np.float32)
        rows = np.empty((3, width), np.float32)
        down = np.empty(width + 2, np.float32)
        for k in range(_BLOCK + 2):
            above, middle, below = rows[k % 3 - 2], rows[k % 3 - 1], rows[k % 3]
            y = min(max(i * _BLOCK + k - 1, 0), height - 1)  # the border pixels are repeated outwards
            if channels == 3:
                red, green, blue = image[y, :, 0], image[y, :, 1], image[y, :, 2]
                for x in range(width):
                    below[x] = np.float32(np.int32(red[x]) + np.int32(green[x]) + np.int32(blue[x])) / np.float32(3)
            else:
                for x in range(width):
                    below[x] = image[y, x, 0]
            if k < 2:
                continue
            for x in range(width):
                down[x + 1] = above[x] - np.float32(2) * middle[x] + below[x]
            down[0], down[width + 1] = down[1], down[width]
            before, same, after = down[:width], down[1 : width + 1], down[2:]
            energy, levels, squares = sums[0], sums[1], sums[2]
            for x in range(width):
                difference = (before[x] - np.float32(2) * same[x] + after[x]) / np.float32(6)
                energy[x] += difference * difference
                levels[x] += middle[x]
                squares[x] += middle[x] * middle[x]
        for n in range(3):
            for j in range(means.shape[2]):
                means[n, i, j] = np.sum(sums[n, j * _BLOCK : (j + 1) * _BLOCK]) / np.float32(_BLOCK**2)


def noise_level(level: NDArray[np.float32], differing: float = 0.0) -> tuple[float, float, int]:
    """Return the standard deviation of an image's noise, levels, the contrast over it, and the radius to average over.

    The contrast is the typical standard deviation within 32 x 32 pixels. Noise is white: averaged over 2 x 2 pixels it
    has a quarter of the energy, while fine texture, which may fill an image as evenly as noise, does not lose any.
    Neighbors share the noise of cameras that smooth or compress. It shows in means over 4 x 4 pixels, as texture does:
    ``differing`` is the share of noise in them, 0 .. 1. The radius grows with the size of its grains.
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


def whitening(levels: Sequence[NDArray[np.float32]]) -> tuple[NDArray[np.float32], float] | None:
    """Return a filter for images in strong noise of any spectrum, (31, 31), and the deviation that it leaves of noise.

    Its gain at a frequency is ``sqrt(S) / N``, S the power of texture and N of noise: Eckart's filter (Knapp, Carter,
    The generalized correlation method for estimation of time delay, TASSP 1976), by which weak signals stand out most.
    Noise is what the flattest blocks have at a distance from frequency 0, texture the rest of the mean. It returns None
    for images smaller than a block, without texture, or of a contrast that averaging leaves enough of.
    """
    n = _SPECTRUM
    if min(levels[0].shape) < n:
        return None
    column, row = np.meshgrid(*2 * [np.minimum(np.arange(n), n - np.arange(n))])
    ring = np.minimum(np.rint(np.hypot(row, column)).astype(int), n // 2).ravel()
    size = np.bincount(ring)
    window = np.outer(*2 * [np.sin(np.pi * np.arange(n) / n) ** 2]) * (8 / 3)  # it keeps the power
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


def _whitened(image: Image, mean: np.float32, kernel: NDArray[np.float32], epsilon: float) -> NDArray[np.uint16]:
    result = np.empty(image.shape, np.uint16)
    margin = len(kernel) // 2 + 2 * _WHITENED_RADIUS
    for y in range(0, image.shape[0], _STRIP):
        first = max(0, y - margin)
        part = image[first : y + _STRIP + margin].astype(np.float32) - mean
        values = cv2.filter2D(part, cv2.CV_32F, kernel, borderType=cv2.BORDER_REFLECT)
        values = cv2.ximgproc.guidedFilter(_level(values), values, _WHITENED_RADIUS, epsilon)[y - first :][:_STRIP]
        result[y : y + _STRIP] = np.rint(65535 * np.clip(values + np.float32(0.5), 0, 1))
    return result


def _differing(left: NDArray[np.float32], right: NDArray[np.float32]) -> float:
    # How far the views differ in means over 4 x 4 pixels, 0 .. 1: flat blocks of texture have a match in the row.
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


def _level(image: NDArray[Any]) -> NDArray[np.float32]:
    # The mean of the channels.
    if image.ndim == 2:
        return image.astype(np.float32)
    return cast(NDArray[np.float32], cv2.transform(image.astype(np.float32), np.full((1, 3), 1 / 3, np.float32)))


def _details(level: NDArray[np.float32]) -> NDArray[np.float32]:
    details = cv2.filter2D(level, cv2.CV_32F, _SECOND_DIFFERENCE, borderType=cv2.BORDER_REFLECT)
    return np.asarray(details * details, np.float32)


def _flat_energy(level: NDArray[np.float32]) -> float:
    return float(np.percentile(_block_means(_details(level), _BLOCK), _FLAT_PERCENTILE))


def _block_means(values: NDArray[np.float32], side: int) -> NDArray[np.float32]:
    # Means of whole blocks, at least of one.
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
            # A weak filter must not take away colors that the guide does not have: then all channels change alike.
            alike = values + (cv2.ximgproc.guidedFilter(guide, guide, radius, epsilon) - guide)[..., None]
            averaged = alike + np.float32(share) * (averaged - alike)
        values = np.clip(averaged[y - first :][:_STRIP] / np.float32(top), 0, 1)
        values = gain * values / (1 + (gain - 1) * values)
        result[y : y + _STRIP] = np.rint(values * np.float32(65535))
    return result
