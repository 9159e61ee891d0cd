"""Truncated squared difference of grey levels."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from depthcli.core.frames import StereoPair
from depthcli.methods.stereo.cost import CostMeasure
from depthcli.methods.stereo.volume import CostVolume


class SquaredDifference(CostMeasure):
    """``(I(y, x) - I'(y, x - d))^2`` of the grey images, truncated."""

    truncation: float = Field(900.0, gt=0, description="largest cost, squared grey levels")
    outside: float = Field(100.0, ge=0, description="cost of a match outside the right image, squared grey levels")

    bytes_per_cost = 4  # float32
    compares_levels = True  # it counts less where the light of the views differs

    def halo(self) -> int:
        """Return 0: a pixel's costs depend on that pixel alone."""
        return 0

    def __call__(self, pair: StereoPair, n_disparities: int) -> CostVolume:
        """Return the (H, W, D) float32 costs."""
        left, right = (image.astype(np.float32) for image in pair.grey8)
        width = left.shape[1]
        costs = np.full((*left.shape, n_disparities), self.outside, np.float32)
        for d in range(min(n_disparities, width)):
            costs[:, d:, d] = np.minimum((left[:, d:] - right[:, : width - d]) ** 2, self.truncation)
        return CostVolume(costs)
