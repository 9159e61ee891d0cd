"""Plain median filter."""

from __future__ import annotations

from typing import ClassVar, Literal

import cv2
import numpy as np
from pydantic import Field

from depthcli.core.maps import DisparityMap, Status
from depthcli.methods.stereo.refinement import Refinement
from depthcli.methods.stereo.volume import RefinementContext


class Median(Refinement):
    """Median of a square window. Pixels without a value stay so; windows that touch one are left alone."""

    needs_costs: ClassVar[bool] = False

    window: Literal[3, 5] = Field(3, description="side of the window, pixels")

    def halo(self) -> int | None:
        return self.window // 2

    def __call__(self, disparity: DisparityMap, context: RefinementContext) -> DisparityMap:
        valid = disparity.valid
        # A window is filtered only if it holds values alone: a median of stand-ins would be an invention.
        whole = cv2.erode(valid.astype(np.uint8), np.ones((self.window, self.window), np.uint8)).astype(bool)
        filtered = cv2.medianBlur(np.where(valid, disparity.values, np.float32(0)), self.window)
        values = np.where(whole, filtered, disparity.values).astype(np.float32)
        changed = whole & (values != disparity.values)
        status = disparity.status | np.where(changed, np.uint8(Status.SMOOTHED), np.uint8(0))
        return DisparityMap(values, status)
