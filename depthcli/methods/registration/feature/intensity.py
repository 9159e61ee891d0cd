"""Plain intensities, for volumes of one modality from one scanner."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field

from depthcli.methods.registration.feature import Channels, VolumeArray, VolumeFeature, levels


class Intensity(VolumeFeature):
    """The intensities, quantized to 256 levels between common percentiles."""

    channels: ClassVar[int] = 1

    outliers: float = Field(0.5, ge=0, lt=25, description="share of values cut off at either end of the range, percent")

    def __call__(self, fixed: VolumeArray, warped: VolumeArray) -> tuple[Channels, Channels]:
        one, other = levels(fixed, warped, self.outliers)
        return one[None], other[None]
