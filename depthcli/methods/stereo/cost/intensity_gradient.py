"""Difference of intensities plus difference of image gradients (thesis, eq. 2.6 and 2.7)."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.core import memory
from depthcli.core.frames import StereoPair
from depthcli.methods.stereo.cost import CostMeasure
from depthcli.methods.stereo.volume import CostVolume, fill_outside


class IntensityGradient(CostMeasure):
    """``|I - I'| + |dI/dx - dI'/dx| + |dI/dy - dI'/dy|``, grey levels, not truncated.

    The difference of intensities is the mean over red, green and blue; derivatives are those of the grey images by
    Sobel's filters.
    """

    outside: float = Field(120.0, ge=0, le=5000, description="cost of a match outside the right image, grey levels")

    bytes_per_cost = 4
    compares_levels = True

    def halo(self) -> int:
        return 1

    def __call__(self, pair: StereoPair, n_disparities: int) -> CostVolume:
        left, right = map(_features, pair.color8, pair.grey8)
        costs = memory.empty((*pair.shape, n_disparities), np.float32)
        width = pair.shape[1]
        for d in range(min(n_disparities, width)):
            costs[:, d:, d] = np.abs(left[:, :, d:] - right[:, :, : width - d]).sum(axis=0) / np.float32(3)
        fill_outside(costs, np.float32(self.outside))
        return CostVolume(costs)


def _features(color: NDArray[np.uint8], grey: NDArray[np.uint8]) -> NDArray[np.int16]:
    # (5, H, W): the channels, and three times the derivatives along x and y.
    slopes = [cv2.Sobel(grey, cv2.CV_16S, *axis, scale=3, borderType=cv2.BORDER_REPLICATE) for axis in ((1, 0), (0, 1))]
    return np.concatenate([color.transpose(2, 0, 1), slopes])
