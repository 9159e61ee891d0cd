"""Confidence-weighted fast global smoothing (OpenCV), as a peer."""

from __future__ import annotations

import cv2
import numpy as np
from pydantic import Field

from depthcli.core.frames import RgbdFrame
from depthcli.core.result import Clock
from depthcli.kinect.noise import noise_level
from depthcli.kinect.outcome import measured_disparity, outcome
from depthcli.kinect.pipeline import KinectPipeline
from depthcli.kinect.result import RefinedDepth
from depthcli.kinect.suspects import jump_distance


class FastGlobalSmoother(KinectPipeline):
    """``FGS(c d) / FGS(c)`` with ``cv2.ximgproc.fastGlobalSmootherFilter``, guided by the color image.

    The confidence c is 0 in gaps, low in the band beside depth edges, else 1 (Min et al., TIP 2014, applied as in
    OpenCV's WLS disparity filter).
    """

    smoothness: float = Field(900.0, gt=0, description="lambda of the smoother")
    sigma_color: float = Field(8.0, gt=0, description="contrast that stops the smoothing, grey levels")
    edge_band: int = Field(5, ge=0, le=64, description="pixels on the near side of a depth edge that are doubted")
    edge_confidence: float = Field(0.01, ge=0, le=1, description="confidence of the doubted pixels")
    jump: float = Field(5.0, gt=0, description="a step of more than this is a depth edge, multiples of the noise")

    def __call__(self, frame: RgbdFrame) -> RefinedDepth:
        clock = Clock()
        measured = measured_disparity(frame)
        noise = noise_level(measured)
        known = ~np.isnan(measured)
        confidence = known.astype(np.float32)
        if self.edge_band:
            band = jump_distance(measured, self.jump * noise).inside(self.edge_band, self.edge_band)
            confidence[known & band] = self.edge_confidence
        clock.stop("confidence")
        weighted = np.where(known, measured, np.float32(0)) * confidence
        smooth = cv2.ximgproc.createFastGlobalSmootherFilter(frame.color, self.smoothness, self.sigma_color)
        above, below = smooth.filter(weighted), smooth.filter(confidence)
        with np.errstate(divide="ignore", invalid="ignore"):
            values = np.where(below > 1e-12, above / below, np.float32(np.nan)).astype(np.float32)
        clock.stop("smoothing")
        sigma = np.where(known, noise, np.nan).astype(np.float32)
        return outcome(frame, values, sigma, noise, clock)

    def peak_bytes(self, shape: tuple[int, int]) -> int:
        return 80 * shape[0] * shape[1]
