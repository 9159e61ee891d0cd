"""Self-similarity context (Heinrich et al., MICCAI 2013): MIND without its center."""

from __future__ import annotations

from typing import ClassVar

from depthcli.methods.registration.feature import Place
from depthcli.methods.registration.feature.mind import Mind


class MindSsc(Mind):
    """Distances between the patches of the six neighbors: 12 channels that do not depend on a noisy center voxel."""

    channels: ClassVar[int] = 12

    def _pairs(self, around: list[Place]) -> list[tuple[Place, Place]]:
        both = [(a, b) for k, a in enumerate(around) for b in around[:k]]
        # Leave out opposite neighbors, whose patches are least similar. A volume with a single axis has no other pairs.
        return [(a, b) for a, b in both if any(p + q for p, q in zip(a, b, strict=True))] or both
