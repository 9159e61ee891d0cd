"""Guided filter of a nearest fill, as a peer."""

from __future__ import annotations

import cv2
import numpy as np
from pydantic import Field

from depthcli.core.frames import RgbdFrame
from depthcli.core.result import Clock
from depthcli.kinect.noise import noise_level
from depthcli.kinect.outcome import measured_disparity, outcome
from depthcli.kinect.pipeline import KinectPipeline
from depthcli.kinect.pipeline.nearest import nearest_fill
from depthcli.kinect.result import RefinedDepth


class Guided(KinectPipeline):
    """``cv2.ximgproc.guidedFilter`` of the nearest known values, guided by the color image (He et al., PAMI 2013)."""

    radius: int = Field(8, ge=1, le=256, description="radius of the window, pixels")
    epsilon: float = Field(100.0, gt=0, le=1e6, description="regularization, squared grey levels")

    def __call__(self, frame: RgbdFrame) -> RefinedDepth:
        clock = Clock()
        measured = measured_disparity(frame)
        values = cv2.ximgproc.guidedFilter(frame.color, nearest_fill(measured), self.radius, self.epsilon)
        clock.stop("filter")
        noise = noise_level(measured)
        sigma = np.where(np.isnan(measured), np.float32(np.nan), np.float32(noise)).astype(np.float32)
        return outcome(frame, values.astype(np.float32), sigma, noise, clock)

    def peak_bytes(self, shape: tuple[int, int]) -> int:
        return 200 * shape[0] * shape[1]
