"""Intensities without local mean and contrast, as in normalized cross-correlation."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from pydantic import Field

from depthcli.algorithms.resampling import gaussian
from depthcli.methods.registration.feature import Channels, VolumeArray, VolumeFeature, levels


class LocalNcc(VolumeFeature):
    """(I - mean) / deviation in a Gaussian window: absolute differences fall as the local correlation rises."""

    channels: ClassVar[int] = 1

    sigma: float = Field(2.0, gt=0.5, le=8, description="Gaussian window of mean and deviation, voxels")
    floor: float = Field(
        0.05, gt=0, le=1, description="smallest local deviation, as a share of the deviation of the whole volume"
    )
    outliers: float = Field(0.5, ge=0, lt=25, description="share of values cut off at either end of the range, percent")

    def __call__(self, fixed: VolumeArray, warped: VolumeArray) -> tuple[Channels, Channels]:
        one, other = levels(self._normalized(fixed), self._normalized(warped), self.outliers)
        return one[None], other[None]

    def _normalized(self, volume: VolumeArray) -> VolumeArray:
        centered = volume - np.float32(volume.mean(dtype=np.float64))
        mean = gaussian(centered, self.sigma)
        variance = gaussian(centered * centered, self.sigma) - mean * mean
        min_variance = (self.floor * float(centered.std(dtype=np.float64))) ** 2 or 1.0
        min_variance = max(min_variance, float(np.finfo(np.float32).tiny))
        normalized = (centered - mean) / np.sqrt(np.maximum(variance, np.float32(min_variance)))
        return normalized.astype(np.float32, copy=False)
