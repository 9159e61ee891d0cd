"""Smoothing at video rate, with low confidence where the sensor fattens near surfaces, and shadows filled first."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from pydantic import Field

from depthcli.algorithms.plane_fitting.window_planes import WindowPlanes
from depthcli.core.frames import RgbdFrame
from depthcli.core.result import Clock, RefinedDepth
from depthcli.methods.kinect.depth_edges import edge_distance
from depthcli.methods.kinect.disparity import measured_disparity, noise_level, refined_depth
from depthcli.methods.kinect.pipeline import KinectPipeline
from depthcli.methods.kinect.pipeline.fast_global_smoother import weighted_smoothing
from depthcli.methods.kinect.shadows import shadow_background, shadow_confidence


class ShadowSmoother(KinectPipeline):
    """``FGS(c d) / FGS(c)`` with low confidence on the near side of depth edges, and shadows filled from their left.

    Wrong measurements lie on the near side of depth edges, and a shadow falls on the surface on its left. In frames
    whose gaps are not as wide as shadows it is a plain smoother.
    """

    bytes_per_pixel: ClassVar[int] = 100

    smoothness: float = Field(60.0, gt=0, description="lambda of the smoother")
    sigma_color: float = Field(4.0, gt=0, description="contrast that stops the smoothing, grey levels")
    row_band: int = Field(
        8, ge=0, le=64, description="unreliable pixels along the row on the near side of a depth edge"
    )
    column_band: int = Field(
        2, ge=0, le=64, description="unreliable pixels along the column on the near side of a depth edge"
    )
    edge_confidence: float = Field(
        0.003, ge=0, le=1, description="confidence of the unreliable pixels beside depth edges"
    )
    shadow_confidence: float = Field(0.5, ge=0, le=1, description="confidence of values that continue into a shadow")
    jump: float = Field(5.0, gt=0, description="a step of more than this is a depth edge, multiples of the noise")
    max_change: float = Field(2.0, ge=0, description="largest change of a reliable measurement, multiples of the noise")

    def __call__(self, frame: RgbdFrame) -> RefinedDepth:
        clock = Clock()
        clock.start("confidence")
        measured = measured_disparity(frame)
        noise = noise_level(measured)
        jump = self.jump * noise
        known = ~np.isnan(measured)
        confidence = known.astype(np.float32)
        band = edge_distance(measured, jump).inside(self.row_band, self.column_band)
        confidence[known & band] = self.edge_confidence
        level = np.zeros_like(measured)
        rims, _ = shadow_background(measured, WindowPlanes(measured, level, level, level), jump, 0.0)
        shadow = ~known & ~np.isnan(rims)
        confidence[shadow] = self.shadow_confidence * shadow_confidence(measured, jump)
        clock.start("smoothing")
        values = weighted_smoothing(
            frame.color, np.where(known, measured, rims), confidence, self.smoothness, self.sigma_color
        )
        # Without a color edge the smoother crosses depth edges: reliable measurements stay.
        crossed = known & ~band & (np.abs(values - measured) > self.max_change * noise)
        values[crossed] = measured[crossed]
        sigma = np.where(known & ~band, noise, np.nan).astype(np.float32)
        return refined_depth(frame, values, sigma, noise, clock)
