"""Smoothing at video rate that knows what a sensor's faults look like."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from depthcli.core.frames import RgbdFrame
from depthcli.core.result import Clock
from depthcli.methods.kinect.noise import noise_level
from depthcli.methods.kinect.outcome import measured_disparity, outcome
from depthcli.methods.kinect.pipeline import KinectPipeline
from depthcli.methods.kinect.pipeline.fast_global_smoother import weighted_smoothing
from depthcli.methods.kinect.result import RefinedDepth
from depthcli.methods.kinect.shadows import shadow_belief, shadow_rims
from depthcli.methods.kinect.suspects import jump_distance

_KEEP = 2.0  # a sure measurement moves by at most so many times the noise


class ShadowSmoother(KinectPipeline):
    """``FGS(c d) / FGS(c)`` with the near side of depth edges doubted and shadows continued from their left.

    What a sensor shows wrong lies on the near side of depth edges alone, and what lies in a shadow is the surface on
    its left: both are told to the smoother by its confidence. In doubtful frames (gaps that do not look like
    shadows) it is a plain smoother.
    """

    smoothness: float = Field(60.0, gt=0, description="lambda of the smoother")
    sigma_color: float = Field(4.0, gt=0, description="contrast that stops the smoothing, grey levels")
    row_band: int = Field(8, ge=0, le=64, description="pixels of the near side that are doubted, along rows")
    column_band: int = Field(2, ge=0, le=64, description="the same along columns")
    edge_confidence: float = Field(0.003, ge=0, le=1, description="confidence of the doubted pixels")
    shadow_confidence: float = Field(0.5, ge=0, le=1, description="confidence of what continues into a shadow")
    jump: float = Field(5.0, gt=0, description="a step of more than this is a depth edge, multiples of the noise")

    def __call__(self, frame: RgbdFrame) -> RefinedDepth:
        clock = Clock()
        measured = measured_disparity(frame)
        noise = noise_level(measured)
        jump = self.jump * noise
        known = ~np.isnan(measured)
        confidence = known.astype(np.float32)
        band = jump_distance(measured, jump).inside(self.row_band, self.column_band)
        confidence[known & band] = self.edge_confidence
        rims = shadow_rims(measured, jump)
        shadow = ~known & ~np.isnan(rims)
        confidence[shadow] = self.shadow_confidence * shadow_belief(measured, jump)
        clock.stop("confidence")
        values = weighted_smoothing(
            frame.color, np.where(known, measured, rims), confidence, self.smoothness, self.sigma_color
        )
        # Where color shows no edge the smoother knows none: what is sure stays.
        sure = known & ~band & (np.abs(values - measured) > _KEEP * noise)
        values[sure] = measured[sure]
        clock.stop("smoothing")
        sigma = np.where(known & ~band, noise, np.nan).astype(np.float32)
        return outcome(frame, values, sigma, noise, clock)

    def peak_bytes(self, shape: tuple[int, int]) -> int:
        return 100 * shape[0] * shape[1]
