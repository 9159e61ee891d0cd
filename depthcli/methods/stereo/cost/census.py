"""Census transform and Hamming distance (thesis, eq. 3.5)."""

from __future__ import annotations

from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.core import memory
from depthcli.core.frames import Image, StereoPair
from depthcli.kernels.jit import empty, jit, run_bands
from depthcli.methods.stereo.cost import CostMeasure, Side, window_check
from depthcli.methods.stereo.cost._fill import hamming_volume
from depthcli.methods.stereo.volume import CostVolume, fill_outside


class Census(CostMeasure):
    """Hamming distance of census bit strings. Bit k is set if neighbor k is brighter than the center."""

    window: Annotated[tuple[Side, Side], window_check(65)] = Field(
        (9, 7), description="window width and height, pixels; both odd, at most 64 neighbors"
    )
    outside: float = Field(16.0, ge=0, le=64, description="cost of a match outside the right image, bits")

    def halo(self) -> int | None:
        return max(self.window) // 2

    def __call__(self, pair: StereoPair, n_disparities: int) -> CostVolume:
        costs = memory.empty((*pair.shape, n_disparities), np.uint8)
        left, right = (census_transform(image, self.window) for image in pair.grey)
        hamming_volume(left, right, costs)
        fill_outside(costs, np.uint8(round(self.outside)))
        return CostVolume(costs, 1.0)


def census_transform(image: Image, window: tuple[int, int]) -> NDArray[np.uint64]:
    """Compute census bit strings of a ``window`` (width, height) of at most 64 neighbors, (H, W) uint64.

    The border pixels of the image are repeated outwards.
    """
    ry, rx = window[1] // 2, window[0] // 2
    padded = cv2.copyMakeBorder(image, ry, ry, rx, rx, cv2.BORDER_REPLICATE)
    bits: NDArray[np.uint64] = memory.empty(image.shape, np.uint64)
    run_bands(_census, len(bits), padded, bits, ry, rx)
    return bits


@jit
def _census(begin, end, padded, bits, ry, rx):
    width = bits.shape[1]
    side, count = 2 * rx + 1, (2 * ry + 1) * (2 * rx + 1) - 1
    for y in range(begin, end):
        part = empty(width, np.uint16)
        out = bits[y]
        out[:] = 0
        center = padded[y + ry, rx : rx + width]
        for first in range(0, count, 16):  # 16-bit vectors have four times as many lanes as 64-bit ones
            stop = min(first + 16, count)
            part[:] = 0
            for k in range(first, stop):
                dy, dx = divmod(k + (k >= count // 2), side)  # leaves out the center
                neighbor = padded[y + dy, dx : dx + width]
                for i in range(part.size):
                    part[i] = (part[i] << np.uint16(1)) | np.uint16(neighbor[i] > center[i])
            for i in range(out.size):
                out[i] = (out[i] << np.uint64(stop - first)) | np.uint64(part[i])
