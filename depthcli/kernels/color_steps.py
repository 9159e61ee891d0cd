"""Color differences between a pixel and nearby pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from depthcli.kernels.jit import empty, jit, run_bands

BEFORE: NDArray[np.int64] = np.array([(0, 1), (1, 0)])
"""Offsets to the left pixel and to the pixel above."""


def color_steps(image: NDArray[np.uint8], back: NDArray[np.int64], largest: bool) -> NDArray[np.uint16]:
    """Return color differences from K nearby pixels: sums over channels, or the ``largest`` channel; (K, H, W) uint16.

    Plane k compares each pixel of the (H, W, 3) image with the pixel ``back[k]`` rows (0 or 1) above and columns to the
    left; 0 if that pixel is outside the image.
    """
    steps = np.zeros((len(back), *image.shape[:2]), np.uint16)
    run_bands(_differences, steps.shape[1], np.ascontiguousarray(image), back, largest, steps)
    return steps


@jit
def _differences(begin, end, image, back, largest, steps):
    n_steps, _, width = steps.shape
    for y in range(begin, end):
        rows = empty((2, 3, width), np.int16)  # planes, since loops over interleaved channels are not vectorized
        for dy in range(min(2, y + 1)):
            for c in range(3):
                for x in range(width):
                    rows[dy, c, x] = image[y - dy, x, c]
        for k in range(n_steps):
            dy, dx = back[k]
            if dy > y:
                continue
            first, stop = max(dx, 0), width + min(dx, 0)
            red, green, blue = rows[0, 0, first:stop], rows[0, 1, first:stop], rows[0, 2, first:stop]
            other = rows[dy, :, first - dx : stop - dx]
            other_red, other_green, other_blue = other[0], other[1], other[2]
            out = steps[k, y, first:stop]
            for i in range(out.size):
                r, g, b = abs(red[i] - other_red[i]), abs(green[i] - other_green[i]), abs(blue[i] - other_blue[i])
                out[i] = max(r, g, b) if largest else r + g + b
