"""The sensor where it can be believed, planes through the samples that agree elsewhere."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from depthcli.core.frames import SparseFrame
from depthcli.core.result import Clock, RefinedDepth
from depthcli.methods.transparent.evidence import gather, outcome
from depthcli.methods.transparent.fit import RobustFit, Smoothing
from depthcli.methods.transparent.pipeline import TransparentPipeline
from depthcli.methods.transparent.suspects import Suspicion


class Robust(TransparentPipeline):
    """Samples are cleaned by their neighbors and fitted; a cut finds where the sensor contradicts the fit."""

    fit: RobustFit = Field(default_factory=RobustFit, description="planes through the samples")
    suspicion: Suspicion = Field(default_factory=Suspicion, description="where the sensor is not believed")
    smoothing: Smoothing = Field(default_factory=Smoothing, description="of the planes, where they replace the sensor")

    def __call__(self, frame: SparseFrame) -> RefinedDepth:
        clock = Clock()
        evidence = gather(frame, self.fit, self.suspicion, clock)
        kept = np.isfinite(evidence.sensor) & ~evidence.suspect
        smooth = self.smoothing(evidence.fit, evidence.samples, frame.color, ~kept)
        values = np.where(kept, evidence.sensor, smooth)
        sigma = np.where(kept, np.float32(evidence.noise), evidence.sigma)
        figures = {"samples": float(evidence.samples.values.size), "noise": evidence.noise}
        result = outcome(frame, values, sigma, evidence.suspect, evidence.sampled(values), clock, figures)
        clock.stop("decode")
        return result

    def peak_bytes(self, shape: tuple[int, int]) -> int:
        """Neighbors of every pixel, and the graph of the cut."""
        return shape[0] * shape[1] * (4 * self.fit.neighbors + 700) + (64 << 20)
