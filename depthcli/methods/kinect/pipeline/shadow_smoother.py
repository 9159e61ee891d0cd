"""Smoothing at video rate: fills shadows first and gives low confidence to the fattened rims of near surfaces."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from pydantic import Field

from depthcli.algorithms.plane_fitting.window_planes import WindowPlanes
from depthcli.core.context import Clock
from depthcli.core.frames import RgbdFrame
from depthcli.core.result import DepthResult
from depthcli.methods.kinect.color import frame_lab
from depthcli.methods.kinect.depth_edges import near_side
from depthcli.methods.kinect.disparity import measured_disparity, noise_level, refined_depth
from depthcli.methods.kinect.gap_filling import UNRELIABLE_COST, fill_gaps
from depthcli.methods.kinect.gap_limits import shadow_background
from depthcli.methods.kinect.pipeline import KinectPipeline
from depthcli.methods.kinect.pipeline.fast_global_smoother import weighted_smoothing
from depthcli.methods.kinect.shadows import SHADOW_SIDES, Side, shadows_of


class ShadowSmoother(KinectPipeline):
    """``FGS(c d) / FGS(c)`` with low confidence on the near side of depth edges, after gaps are filled.

    Incorrect measurements are on the near side of depth edges. A shadow takes the value of the far surface next to it.
    Other gaps take the value at the start of the cheapest path into them (``kinect.gap_filling``).
    """

    bytes_per_pixel: ClassVar[int] = 100

    smoothness: float = Field(40.0, gt=0, description="lambda of the smoother")
    sigma_color: float = Field(4.0, gt=0, description="contrast that stops the smoothing, grey levels")
    row_band: int = Field(
        8, ge=0, le=64, description="number of unreliable pixels along the row, on the near side of an edge"
    )
    column_band: int = Field(2, ge=0, le=64, description="the same along the column")
    edge_confidence: float = Field(0.003, ge=0, le=1, description="confidence of unreliable pixels at depth edges")
    shadow_confidence: float = Field(0.5, ge=0, le=1, description="confidence of values that continue into a shadow")
    shadows: bool | Side = Field(True, description=SHADOW_SIDES)
    gap_confidence: float = Field(1.0, ge=0, le=1, description="confidence of values that continue into other gaps")
    jump: float = Field(5.0, gt=0, description="a step of more than this is a depth edge, multiples of the noise")
    max_change: float = Field(2.0, ge=0, description="largest change of a reliable measurement, multiples of the noise")

    def __call__(self, frame: RgbdFrame) -> DepthResult:
        clock = Clock()
        clock.start("confidence")
        measured = measured_disparity(frame)
        noise = noise_level(measured)
        jump = self.jump * noise
        known = ~np.isnan(measured)
        confidence = known.astype(np.float32)
        shadows = shadows_of(measured, jump, self.shadows).likely()
        # If most gaps are holes, a wide gap is no evidence that surfaces have grown over it.
        tolerance = 2.5 if shadows.p_hole < 0.5 else np.inf
        band = np.zeros(measured.shape, bool)
        if frame.has_color:  # without colors, true outlines are unknown
            band = near_side(measured, jump, self.row_band, self.column_band, tolerance)
        confidence[known & band] = self.edge_confidence
        level = np.zeros_like(measured)
        rims, _ = shadow_background(measured, WindowPlanes(measured, level, level, level), jump, shadows)
        shadow = ~known & ~np.isnan(rims)
        cost = np.where(band, np.float32(UNRELIABLE_COST), np.float32(0))
        joined, _ = fill_gaps(measured, frame_lab(frame), None, None, cost, None)
        start = np.where(known, measured, np.where(shadow, rims, joined))
        confidence[~known] = self.gap_confidence
        confidence[shadow] = self.shadow_confidence
        clock.start("smoothing")
        guide = frame.color
        if not frame.has_color:  # then the depth's own edges stop the smoothing
            low, high = float(start.min()), float(start.max())
            levels = np.rint((start - low) * np.float32(255 / max(high - low, 1e-6))).astype(np.uint8)
            guide = np.repeat(levels[..., None], 3, axis=2)
        values = weighted_smoothing(guide, start, confidence, self.smoothness, self.sigma_color)
        # The smoother crosses depth edges that have no color edge. Keep reliable measurements there.
        crossed = known & ~band & (np.abs(values - measured) > self.max_change * noise)
        values[crossed] = measured[crossed]
        result = refined_depth(frame, values, noise, clock)
        result.figures = shadows.figures()
        return result
