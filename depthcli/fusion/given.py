"""A finished cost volume in the place of a cost measure: how pipelines of ``stereo`` work on fused costs."""

from __future__ import annotations

from typing import Any

from pydantic import Field

from depthcli.core.frames import StereoPair
from depthcli.stereo.cost import CostMeasure
from depthcli.stereo.volume import CostVolume


class Given(CostMeasure):
    """Always the same volume, for the one pair it was made of."""

    volume: Any = Field(exclude=True, description="a CostVolume")

    def __call__(self, pair: StereoPair, disparities: int) -> CostVolume:
        volume: CostVolume = self.volume
        if volume.costs.shape != (*pair.shape, disparities):
            raise ValueError(f"the volume is {volume.costs.shape}, not of this pair or search range")
        return volume
