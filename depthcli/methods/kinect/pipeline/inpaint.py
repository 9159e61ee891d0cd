"""OpenCV's inpainting of the gaps, for comparison."""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np
from pydantic import Field

from depthcli.core.frames import RgbdFrame
from depthcli.core.maps import Floats
from depthcli.methods.kinect.pipeline import FilterPipeline

_ALGORITHMS = {"telea": cv2.INPAINT_TELEA, "navier-stokes": cv2.INPAINT_NS}


class Inpaint(FilterPipeline):
    """``cv2.inpaint`` on the disparity: fills gaps from their rims, without the color image.

    OpenCV's 32-bit version overshoots, so filled values are limited to the measured range.
    """

    algorithm: Literal["telea", "navier-stokes"] = Field("telea", description="fast marching, or fluid dynamics")
    radius: float = Field(3.0, gt=0, le=50, description="neighborhood that a pixel is filled from, pixels")

    def filtered(self, frame: RgbdFrame, measured: Floats, noise: float) -> Floats:
        gaps = np.isnan(measured)
        values = np.where(gaps, np.float32(0), measured)
        if gaps.any():
            values = cv2.inpaint(values, gaps.astype(np.uint8), self.radius, _ALGORITHMS[self.algorithm])
            values = np.where(gaps, np.clip(values, np.nanmin(measured), np.nanmax(measured)), measured)
        return values.astype(np.float32)
