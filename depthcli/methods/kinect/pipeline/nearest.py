"""The nearest known value, as a peer."""

from __future__ import annotations

import numpy as np

from depthcli.core.frames import RgbdFrame
from depthcli.core.result import Clock
from depthcli.methods.kinect.fill import nearest_fill
from depthcli.methods.kinect.noise import noise_level
from depthcli.methods.kinect.outcome import measured_disparity, outcome
from depthcli.methods.kinect.pipeline import KinectPipeline
from depthcli.methods.kinect.result import RefinedDepth


class Nearest(KinectPipeline):
    """Every gap pixel takes the disparity of the nearest known one; what was measured stays."""

    def __call__(self, frame: RgbdFrame) -> RefinedDepth:
        clock = Clock()
        measured = measured_disparity(frame)
        filled = nearest_fill(measured)
        clock.stop("fill")
        noise = noise_level(measured)
        sigma = np.where(np.isnan(measured), np.nan, noise).astype(np.float32)
        return outcome(frame, filled, sigma, noise, clock)

    def peak_bytes(self, shape: tuple[int, int]) -> int:
        return 50 * shape[0] * shape[1]
