"""Truncated absolute difference of colors (thesis, eq. 3.1)."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from pydantic import Field

from depthcli.core import memory
from depthcli.core.frames import StereoPair
from depthcli.methods.stereo.cost import CostMeasure, Sampling
from depthcli.methods.stereo.cost._fill import difference_volume
from depthcli.methods.stereo.volume import CostVolume, fill_outside


class AbsoluteDifference(CostMeasure):
    """Mean over the channels of ``|I(y, x) - I'(y, x - d)|``, truncated.

    The sum over the channels (thesis, eq. 3.1) is divided by their number, so that the mean is in grey levels as Mei et
    al.'s lambda. Three channels are stored as their exact sum (scale 3).
    """

    aliases = ("AD", "SAD")

    truncation: float = Field(60.0, gt=0, le=255, description="largest absolute difference, grey levels")
    sampling: Sampling = "exact"
    outside: float = Field(20.0, ge=0, le=255, description="cost of a match outside the right image, grey levels")

    MAX_STORED: ClassVar[int] = 255
    compares_levels = True

    def halo(self) -> int | None:
        return 1 if self.sampling == "tolerant" else 0

    def __call__(self, pair: StereoPair, n_disparities: int) -> CostVolume:
        if pair.left.ndim == 3:
            left, right = (np.ascontiguousarray(image.transpose(2, 0, 1)) for image in pair.color8)
        else:
            left, right = (image[None] for image in pair.grey8)
        scale = left.shape[0]
        costs = memory.empty((*pair.shape, n_disparities), np.uint8)
        limit = min(round(self.truncation * scale), self.MAX_STORED)
        difference_volume(left, right, costs, limit, self.sampling)
        fill_outside(costs, np.uint8(min(round(self.outside * scale), limit)))
        return CostVolume(costs, float(scale))
