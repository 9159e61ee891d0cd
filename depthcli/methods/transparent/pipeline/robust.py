"""The sensor where it is reliable, planes through the samples that agree elsewhere."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from pydantic import Field

from depthcli.algorithms.plane_fitting.sample_planes import SamplePlaneFit
from depthcli.core.frames import SparseFrame
from depthcli.core.result import Clock, DepthResult
from depthcli.methods.transparent.fitted_frame import fit_frame, refined_depth
from depthcli.methods.transparent.pipeline import TransparentPipeline
from depthcli.methods.transparent.smoothing import Smoothing
from depthcli.methods.transparent.unreliable import UnreliableRegions


class RobustPlanes(TransparentPipeline):
    """Planes through cleaned samples replace the sensor where a graph cut finds that it contradicts them."""

    renamed: ClassVar[dict[str, str]] = {"suspicion": "unreliable"}

    fit: SamplePlaneFit = Field(default_factory=SamplePlaneFit, description="planes through the samples")
    unreliable: UnreliableRegions = Field(
        default_factory=UnreliableRegions, description="where the sensor is unreliable"
    )
    smoothing: Smoothing = Field(
        default_factory=Smoothing, description="how the planes are smoothed where they replace the sensor"
    )

    def __call__(self, frame: SparseFrame) -> DepthResult:
        clock = Clock()
        fitted = fit_frame(frame, self.fit, self.unreliable, clock)
        clock.start("decode")
        kept = np.isfinite(fitted.sensor) & ~fitted.unreliable
        smooth = self.smoothing(fitted.fit, fitted.samples, frame.color, ~kept)
        values = np.where(kept, fitted.sensor, smooth)
        sigma = np.where(kept, np.float32(fitted.noise), fitted.sigma)
        figures = {"samples": float(fitted.samples.values.size), "noise": fitted.noise}
        return refined_depth(frame, values, fitted.unreliable, clock, sigma, fitted.sampled(values), figures)

    def peak_bytes(self, shape: tuple[int, int]) -> int:
        # Neighbors of every pixel, and the graph of the cut.
        return shape[0] * shape[1] * (4 * self.fit.neighbors + 700) + (64 << 20)
