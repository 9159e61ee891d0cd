"""OpenCV's inpainting of the gaps, as a peer."""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np
from pydantic import Field

from depthcli.core.frames import RgbdFrame
from depthcli.core.result import Clock
from depthcli.methods.kinect.noise import noise_level
from depthcli.methods.kinect.outcome import measured_disparity, outcome
from depthcli.methods.kinect.pipeline import KinectPipeline
from depthcli.methods.kinect.result import RefinedDepth

_ALGORITHMS = {"telea": cv2.INPAINT_TELEA, "navier-stokes": cv2.INPAINT_NS}


class Inpaint(KinectPipeline):
    """``cv2.inpaint`` on the disparity: gaps are filled from their rims, without the color image.

    The 32-bit version overshoots: values are kept within those measured.
    """

    algorithm: Literal["telea", "navier-stokes"] = Field("telea", description="fast marching, or fluid dynamics")
    radius: float = Field(3.0, gt=0, le=50, description="neighborhood that a pixel is filled from, pixels")

    def __call__(self, frame: RgbdFrame) -> RefinedDepth:
        clock = Clock()
        measured = measured_disparity(frame)
        gaps = np.isnan(measured)
        values = np.where(gaps, np.float32(0), measured)
        if gaps.any():
            values = cv2.inpaint(values, gaps.astype(np.uint8), self.radius, _ALGORITHMS[self.algorithm])
            values = np.where(gaps, np.clip(values, np.nanmin(measured), np.nanmax(measured)), measured)
        clock.stop("inpainting")
        noise = noise_level(measured)
        sigma = np.where(gaps, np.nan, noise).astype(np.float32)
        return outcome(frame, values.astype(np.float32), sigma, noise, clock)

    def peak_bytes(self, shape: tuple[int, int]) -> int:
        return 60 * shape[0] * shape[1]
