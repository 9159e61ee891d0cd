"""Confidence-weighted fast global smoothing (OpenCV), for comparison."""

from __future__ import annotations

from typing import ClassVar

import cv2
import numpy as np
from pydantic import Field

from depthcli.algorithms.filters import beside_steps, single_thread
from depthcli.core.frames import RgbdFrame
from depthcli.core.maps import Floats, Image8
from depthcli.methods.kinect.pipeline import FilterPipeline


class FastGlobalSmoother(FilterPipeline):
    """``FGS(c d) / FGS(c)`` with ``cv2.ximgproc.fastGlobalSmootherFilter``, guided by the color image.

    The confidence c is 0 in gaps, low in a band along depth edges and gaps, and 1 elsewhere (Min et al., TIP 2014,
    applied as in OpenCV's WLS disparity filter).
    """

    bytes_per_pixel: ClassVar[int] = 80

    smoothness: float = Field(900.0, gt=0, description="lambda of the smoother")
    sigma_color: float = Field(5.0, gt=0, description="contrast that stops the smoothing, grey levels")
    edge_band: int = Field(2, ge=0, le=64, description="pixels around a depth edge that are unreliable")
    edge_confidence: float = Field(0.01, ge=0, le=1, description="confidence of unreliable pixels at depth edges")
    jump: float = Field(5.0, gt=0, description="a step of more than this is a depth edge, multiples of the noise")

    def filtered(self, frame: RgbdFrame, measured: Floats, noise: float) -> Floats:
        known = ~np.isnan(measured)
        confidence = known.astype(np.float32)
        if self.edge_band:
            # Steps, and changes between known and unknown pixels.
            across, down = (
                (np.abs(np.diff(measured, axis=axis)) > self.jump * noise) | np.diff(known, axis=axis)
                for axis in (1, 0)
            )
            edge = beside_steps(across, down).astype(np.uint8)
            band = cv2.dilate(edge, np.ones((2 * self.edge_band + 1,) * 2, np.uint8)) > 0
            confidence[known & band] = self.edge_confidence
        return weighted_smoothing(frame.color, measured, confidence, self.smoothness, self.sigma_color)


def weighted_smoothing(
    color: Image8, disparity: Floats, confidence: Floats, smoothness: float, sigma_color: float
) -> Floats:
    """Compute ``FGS(c d) / FGS(c)``, (H, W) float32, with OpenCV's filter; NaN where the denominator is about 0.

    The confidence c is >= 0, and 0 at unknown disparities.
    """
    weighted = np.where(confidence > 0, disparity, np.float32(0)) * confidence
    with single_thread():
        smooth = cv2.ximgproc.createFastGlobalSmootherFilter(color, smoothness, sigma_color)
        numerator, denominator = smooth.filter(weighted), smooth.filter(confidence)
    return np.divide(numerator, denominator, out=np.full_like(numerator, np.nan), where=denominator > 1e-12)
