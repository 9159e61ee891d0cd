"""Plain median filter."""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np
from pydantic import Field

from depthcli.core.maps import DisparityMap
from depthcli.methods.stereo.refinement import Refinement, with_smoothed
from depthcli.methods.stereo.volume import RefinementContext


class Median(Refinement):
    """Median of a square window. If a window has a pixel without a value, its center is not changed."""

    needs_costs = False

    window: Literal[3, 5] = Field(3, description="side of the median's window, pixels")

    def halo(self) -> int | None:
        return self.window // 2

    def __call__(self, disparity: DisparityMap, context: RefinementContext) -> DisparityMap:
        valid = disparity.valid
        if valid.all():
            return with_smoothed(disparity, np.asarray(cv2.medianBlur(disparity.values, self.window), np.float32))
        whole = cv2.erode(valid.astype(np.uint8), np.ones((self.window, self.window), np.uint8)).astype(bool)
        filtered = cv2.medianBlur(np.where(valid, disparity.values, np.float32(0)), self.window)
        values = np.where(whole, filtered, disparity.values).astype(np.float32)
        return with_smoothed(disparity, values)
