"""Self-similarity context (Heinrich et al., MICCAI 2013): MIND without its center."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field

from depthcli.methods.registration.feature import Channels, VolumeArray, VolumeFeature, descriptor, steps


class MindSsc(VolumeFeature):
    """Distances between the patches of the six neighbors: 12 channels that do not depend on a noisy center voxel."""

    channels: ClassVar[int] = 12

    sigma: float = Field(0.8, gt=0.2, le=4, description="Gaussian weight of a patch, voxels")
    distance: int = Field(1, ge=1, le=4, description="distance of the neighbors, voxels")

    def __call__(self, fixed: VolumeArray, warped: VolumeArray) -> tuple[Channels, Channels]:
        around = steps(fixed.shape, self.distance)
        both = [(a, b) for k, a in enumerate(around) for b in around[:k]]
        # Opposite neighbors are left out: their patches are the least alike, and say the least. A line has no others.
        pairs = [(a, b) for a, b in both if any(p + q for p, q in zip(a, b, strict=True))] or both
        return descriptor(fixed, pairs, self.sigma), descriptor(warped, pairs, self.sigma)
