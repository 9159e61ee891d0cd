"""The guided filter on a filled map, as a peer."""

from __future__ import annotations

import cv2
import numpy as np
from pydantic import Field

from depthcli.core.frames import RgbdFrame
from depthcli.core.result import Clock
from depthcli.methods.kinect.fill import nearest_fill
from depthcli.methods.kinect.noise import noise_level
from depthcli.methods.kinect.outcome import measured_disparity, outcome
from depthcli.methods.kinect.pipeline import KinectPipeline
from depthcli.methods.kinect.result import RefinedDepth


class Guided(KinectPipeline):
    """Gaps are filled with the nearest value, then all is smoothed along the color (He, Sun and Tang, PAMI 2013)."""

    radius: int = Field(8, ge=1, le=100, description="of the filter's windows, pixels")
    epsilon: float = Field(40.0, gt=0, description="variance of the color that counts as none, square grey levels")

    def __call__(self, frame: RgbdFrame) -> RefinedDepth:
        clock = Clock()
        measured = measured_disparity(frame)
        filled = nearest_fill(measured)
        clock.stop("fill")
        values = np.asarray(cv2.ximgproc.guidedFilter(frame.color, filled, self.radius, self.epsilon), np.float32)
        clock.stop("smoothing")
        noise = noise_level(measured)
        sigma = np.where(np.isnan(measured), np.nan, noise).astype(np.float32)
        return outcome(frame, values, sigma, noise, clock)

    def peak_bytes(self, shape: tuple[int, int]) -> int:
        return 250 * shape[0] * shape[1]
