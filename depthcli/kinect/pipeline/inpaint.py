"""OpenCV's image inpainting on depth, as a peer."""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np
from pydantic import Field

from depthcli.core.frames import RgbdFrame
from depthcli.core.result import Clock
from depthcli.kinect.noise import noise_level
from depthcli.kinect.outcome import measured_disparity, outcome
from depthcli.kinect.pipeline import KinectPipeline
from depthcli.kinect.result import RefinedDepth

_CODES = {"telea": cv2.INPAINT_TELEA, "navier_stokes": cv2.INPAINT_NS}
_MOST = 65535


class Inpaint(KinectPipeline):
    """``cv2.inpaint`` of the gaps (Telea 2004, or after Bertalmio et al. 2001); it does not look at the color."""

    algorithm: Literal["telea", "navier_stokes"] = Field("telea", description="which of OpenCV's two algorithms")
    radius: float = Field(3.0, gt=0, le=64, description="neighborhood of each filled pixel, pixels")

    def __call__(self, frame: RgbdFrame) -> RefinedDepth:
        clock = Clock()
        measured = measured_disparity(frame)
        gap = np.isnan(measured)
        # OpenCV inpaints 16-bit codes; the whole range of disparities is spread over them.
        low, high = float(np.nanmin(measured)), float(np.nanmax(measured))
        scale = (_MOST - 1) / max(high - low, 1e-6)
        codes = np.rint((np.where(gap, low, measured) - low) * scale).astype(np.uint16)
        filled = cv2.inpaint(codes, gap.astype(np.uint8), self.radius, _CODES[self.algorithm])
        values = np.where(gap, filled / scale + low, measured).astype(np.float32)
        clock.stop("inpainting")
        noise = noise_level(measured)
        sigma = np.where(gap, np.float32(np.nan), np.float32(noise)).astype(np.float32)
        return outcome(frame, values, sigma, noise, clock)

    def peak_bytes(self, shape: tuple[int, int]) -> int:
        return 80 * shape[0] * shape[1]
