"""Modality independent neighborhood descriptor (Heinrich et al., Medical Image Analysis 2012)."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field

from depthcli.methods.registration.feature import Channels, Place, VolumeArray, VolumeFeature, descriptor, steps


class Mind(VolumeFeature):
    """Distances of a voxel's patch to its six neighbors' patches: similar for other contrasts and modalities."""

    channels: ClassVar[int] = 6

    sigma: float = Field(0.8, gt=0.2, le=4, description="Gaussian weight of a patch, voxels")
    distance: int = Field(1, ge=1, le=4, description="distance of the neighbors, voxels")

    def __call__(self, fixed: VolumeArray, warped: VolumeArray) -> tuple[Channels, Channels]:
        pairs = self._pairs(steps(fixed.shape, self.distance))
        return descriptor(fixed, pairs, self.sigma), descriptor(warped, pairs, self.sigma)

    def _pairs(self, around: list[Place]) -> list[tuple[Place, Place]]:
        return [(place, (0, 0, 0)) for place in around]
