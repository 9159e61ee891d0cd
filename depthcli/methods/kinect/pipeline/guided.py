"""The guided filter on a filled map, for comparison."""

from __future__ import annotations

from typing import ClassVar

import cv2
import numpy as np
from pydantic import Field

from depthcli.core.frames import RgbdFrame
from depthcli.core.maps import Floats
from depthcli.methods.kinect.disparity import nearest_fill
from depthcli.methods.kinect.pipeline import FilterPipeline


class Guided(FilterPipeline):
    """Fill gaps with the nearest value, then smooth with edges kept where the colors differ (He et al., PAMI 2013)."""

    bytes_per_pixel: ClassVar[int] = 250

    radius: int = Field(8, ge=1, le=100, description="radius of the filter's windows, pixels")
    epsilon: float = Field(40.0, gt=0, description="color variance up to which the filter smooths, squared grey levels")

    def filtered(self, frame: RgbdFrame, measured: Floats, noise: float) -> Floats:
        filled = nearest_fill(measured)
        return np.asarray(cv2.ximgproc.guidedFilter(frame.color, filled, self.radius, self.epsilon), np.float32)
