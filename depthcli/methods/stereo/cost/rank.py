"""Difference of rank transforms (thesis, eq. 3.3-3.4; Zabih & Woodfill, ECCV 1994)."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from depthcli.core import memory
from depthcli.core.frames import Image, StereoPair
from depthcli.core.maps import Image8
from depthcli.kernels.jit import jit, run_bands
from depthcli.methods.stereo.cost import CostMeasure, Side, window_check
from depthcli.methods.stereo.cost._fill import difference_volume
from depthcli.methods.stereo.volume import CostVolume, fill_outside


class Rank(CostMeasure):
    """``|RT(y, x) - RT'(y, x - d)|``, where RT is the number of pixels of a window darker than its center."""

    window: Annotated[tuple[Side, Side], window_check(255)] = Field(
        (9, 9), description="window width and height, pixels; both odd, area at most 255"
    )
    outside: float = Field(16.0, ge=0, le=255, description="cost of a match outside the right image, ranks")

    def halo(self) -> int | None:
        return max(self.window) // 2

    def __call__(self, pair: StereoPair, n_disparities: int) -> CostVolume:
        costs = memory.empty((*pair.shape, n_disparities), np.uint8)
        left, right = (rank_transform(image, self.window) for image in pair.grey)
        difference_volume(left[None], right[None], costs, 255)
        fill_outside(costs, np.uint8(round(self.outside)))
        return CostVolume(costs, 1.0)


def rank_transform(image: Image, window: tuple[int, int]) -> Image8:
    """Count the pixels darker than the center in the ``window`` (width, height) of every pixel, (H, W) uint8.

    The border pixels of the image are repeated outwards.
    """
    ry, rx = window[1] // 2, window[0] // 2
    padded = np.pad(image, ((ry, ry), (rx, rx)), mode="edge")
    ranks = np.zeros(image.shape, np.uint8)
    run_bands(_rank, len(ranks), padded, ranks, ry, rx)
    return ranks


@jit
def _rank(begin, end, padded, ranks, ry, rx):
    width = ranks.shape[1]
    for y in range(begin, end):
        out = ranks[y]
        center = padded[y + ry, rx : rx + width]
        for dy in range(2 * ry + 1):
            for dx in range(2 * rx + 1):
                neighbor = padded[y + dy, dx : dx + width]
                for i in range(out.size):
                    out[i] = np.uint8(out[i] + np.uint8(neighbor[i] < center[i]))
