"""Cross-shaped supports: four arms per pixel that end where the color changes.

Zhang, Lu & Lafruit 2009 (thesis, eq. 3.8-3.9) with the two-threshold rule of Mei et al. 2011.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from depthcli.kernels.jit import jit, parallel_jit, prange


def cross_arms(
    image: NDArray[np.uint8], length: int, threshold: int, inner_length: int, inner_threshold: int
) -> NDArray[np.uint8]:
    """Return the arm lengths of every pixel.

    An arm grows while (1) the next pixel differs from the center by at most ``threshold`` and, from the
    second step on, from the pixel before it as well, (2) it is no longer than ``length``, (3) beyond
    ``inner_length`` the difference from the center is at most ``inner_threshold``. Differences are the largest
    over the channels. Every arm inside the image has at least one pixel, so that no support is a point.

    Parameters
    ----------
    image : (H, W, C) uint8
    length, inner_length : pixels, at most 255
    threshold, inner_threshold : grey levels

    Returns
    -------
    (4, H, W) uint8: left, right, up, down
    """
    planes = np.ascontiguousarray(image.transpose(2, 0, 1))
    arms = np.empty((4, *image.shape[:2]), np.uint8)
    _grow_horizontal(planes, arms, length, threshold, inner_length, inner_threshold)
    _grow_vertical(planes, arms, length, threshold, inner_length, inner_threshold)
    return arms


# Both kernels advance the arms of a whole row of pixels by one step at a time: the loop over pixels is
# branch-free SIMD, and ``alive`` remembers which arms still grow.


@jit
def _step(center, neighbor, previous, alive, arm, limit, threshold):
    # Arms grow to ``neighbor`` where it differs from ``center`` by at most limit, from ``previous`` by threshold.
    for k in range(center.shape[0]):
        a, b, c = center[k], neighbor[k], previous[k]
        for i in range(alive.size):
            value = np.int16(b[i])
            far = np.uint8(np.int16(abs(np.int16(np.int16(a[i]) - value))) > limit)
            jump = np.uint8(np.int16(abs(np.int16(np.int16(c[i]) - value))) > threshold)
            alive[i] = np.uint8(alive[i] & np.uint8(1 - np.uint8(far | jump)))
    for i in range(alive.size):
        arm[i] = np.uint8(arm[i] + alive[i])


@parallel_jit
def _grow_horizontal(planes, arms, length, threshold, inner_length, inner_threshold):
    _, height, width = planes.shape
    for y in prange(height):
        row = planes[:, y]
        for side in range(2):
            arm = arms[side, y]
            arm[:] = 0
            alive = np.ones(width, np.uint8)
            for step in range(1, min(length, width - 1) + 1):
                limit = np.int16(threshold if step <= inner_length else inner_threshold)
                n = width - step
                if side == 1:
                    _step(row[:, :n], row[:, step:], row[:, step - 1 : width - 1], alive[:n], arm[:n],
                          limit, np.int16(threshold))  # fmt: skip
                else:
                    _step(row[:, step:], row[:, :n], row[:, 1 : n + 1], alive[step:], arm[step:],
                          limit, np.int16(threshold))  # fmt: skip
            for x in range(width):
                room = x if side == 0 else width - 1 - x
                arm[x] = max(arm[x], np.uint8(min(1, room)))


@parallel_jit
def _grow_vertical(planes, arms, length, threshold, inner_length, inner_threshold):
    _, height, width = planes.shape
    for y in prange(height):
        for side in range(2, 4):
            direction = -1 if side == 2 else 1
            room = y if side == 2 else height - 1 - y
            arm = arms[side, y]
            arm[:] = 0
            alive = np.ones(width, np.uint8)
            for step in range(1, min(length, room) + 1):
                limit = np.int16(threshold if step <= inner_length else inner_threshold)
                v = y + direction * step
                _step(planes[:, y], planes[:, v], planes[:, v - direction], alive, arm, limit, np.int16(threshold))
            shortest = np.uint8(min(1, room))
            for x in range(width):
                arm[x] = max(arm[x], shortest)
