"""Smoothed derivatives along the axes."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from pydantic import Field

from depthcli.algorithms.resampling import gaussian, shifted
from depthcli.methods.registration.feature import Channels, VolumeArray, VolumeFeature, levels


class GradientFeature(VolumeFeature):
    """Central differences of the smoothed volumes: insensitive to slow changes of brightness."""

    channels: ClassVar[int] = 3

    sigma: float = Field(1.0, ge=0, le=4, description="smoothing before the differences, voxels")
    outliers: float = Field(0.5, ge=0, lt=25, description="share of values cut off at either end of the range, percent")

    def __call__(self, fixed: VolumeArray, warped: VolumeArray) -> tuple[Channels, Channels]:
        one, other = (self._derivatives(volume) for volume in (fixed, warped))
        return levels(one, other, self.outliers)

    def _derivatives(self, volume: VolumeArray) -> VolumeArray:
        smooth = gaussian(volume, self.sigma)
        axes = [axis for axis in range(3) if volume.shape[axis] > 1] or [2]
        steps = [tuple(int(a == axis) for a in range(3)) for axis in axes]
        return np.stack([(shifted(smooth, s) - shifted(smooth, [-v for v in s])) / np.float32(2) for s in steps])
