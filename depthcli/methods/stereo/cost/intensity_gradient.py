"""Difference of intensities plus difference of image gradients (thesis, eq. 2.6 and 2.7)."""

from __future__ import annotations

from typing import Annotated, Literal

import cv2
import numpy as np
from pydantic import Field

from depthcli.core import memory
from depthcli.core.frames import StereoPair
from depthcli.core.maps import Floats, Image8
from depthcli.methods.stereo.cost import CostMeasure
from depthcli.methods.stereo.cost.gradient import derivative_filters
from depthcli.methods.stereo.volume import CostVolume, fill_outside

_Level = Annotated[float, Field(gt=0, le=5000)]


class IntensityGradient(CostMeasure):
    """``|I - I'| + |dI/dx - dI'/dx| + |dI/dy - dI'/dy|``, grey levels, where ``limits`` truncates both parts.

    ``channels``: the mean difference of red, green and blue, and derivatives of the grey images; or sums over the three
    channels of both. ``filter``: Sobel's 3 x 3, or 5 x 5 derivatives of a Gaussian of 1 pixel, each the difference of
    two means (thesis, section 3.1.1).
    """

    filter: Literal["sobel", "dog"] = Field("sobel", description="derivatives: Sobel's, or of a Gaussian")
    channels: Literal["grey", "color"] = Field(
        "grey", description="grey: mean of differences, derivatives of the grey images; color: sums over the channels"
    )
    limits: tuple[_Level, _Level] | None = Field(
        None, description="largest difference of intensities and of gradients, grey levels; null: none"
    )
    outside: Annotated[float, Field(ge=0, le=5000)] | Literal["border"] = Field(
        120.0,
        description="cost of a match outside the right image, grey levels; border: the cost of the nearest column",
    )

    bytes_per_cost = 4
    compares_levels = True

    def halo(self) -> int:
        return 1 if self.filter == "sobel" else 2

    def __call__(self, pair: StereoPair, n_disparities: int) -> CostVolume:
        left, right = map(self._features, pair.color8, pair.grey8)
        costs = memory.empty((*pair.shape, n_disparities), np.float32)
        width, margin = pair.shape[1], n_disparities - 1 if self.outside == "border" else 0
        right = np.pad(right, ((0, 0), (0, 0), (margin, 0)), "edge")
        scale = np.float32(3 if self.channels == "grey" else 1)
        for d in range(n_disparities if margin else min(n_disparities, width)):
            first = 0 if margin else d
            place = first + margin - d
            differences = np.abs(left[:, :, first:] - right[:, :, place : place + width - first])
            if self.limits is None:
                total = differences.sum(axis=0)
            else:
                parts = differences[:3].sum(axis=0), differences[3:].sum(axis=0)
                total = sum(np.minimum(part, np.float32(t) * scale) for part, t in zip(parts, self.limits, strict=True))
            costs[:, first:, d] = total / scale
        if self.outside != "border":
            fill_outside(costs, np.float32(self.outside))
        return CostVolume(costs)

    def _features(self, color: Image8, grey: Image8) -> Floats:
        # (5, H, W) or (9, H, W): the channels, and the derivatives along x and y; of grey images three times these.
        smooth, slope = derivative_filters(1.0)
        slope = slope / slope[slope > 0].sum()
        directions = (slope, smooth), (smooth, slope)
        planes = color.transpose(2, 0, 1) if self.channels == "color" else grey[None]
        image = np.ascontiguousarray(planes, np.float32) * np.float32(1 if self.channels == "color" else 3)
        border = cv2.BORDER_REPLICATE
        slopes = []
        for plane in image:
            if self.filter == "sobel":
                slopes += [cv2.Sobel(plane, cv2.CV_32F, *axis, borderType=border) for axis in ((1, 0), (0, 1))]
            else:
                slopes += [cv2.sepFilter2D(plane, cv2.CV_32F, h, v, borderType=border) for h, v in directions]
        return np.stack([*color.transpose(2, 0, 1).astype(np.float32), *slopes])
