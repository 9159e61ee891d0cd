"""The sensor's depth where it is reliable, and planes through agreeing samples elsewhere."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from pydantic import Field

from depthcli.algorithms.plane_fitting.sample_planes import SamplePlaneFit, Samples
from depthcli.core.context import Clock
from depthcli.core.frames import SparseFrame
from depthcli.core.maps import Floats, Image8, Mask
from depthcli.core.method import ConfigModel
from depthcli.core.result import DepthResult
from depthcli.kernels.jit import jit, run_bands
from depthcli.methods.transparent.fitted_frame import fit_frame, refined_depth
from depthcli.methods.transparent.pipeline import TransparentPipeline
from depthcli.methods.transparent.unreliable import UnreliableRegions


class Smoothing(ConfigModel):
    """The mean of a window, weighted by color similarity, at pixels far from all samples.

    There a plane is an extrapolation, and neighboring pixels have planes through other samples. The mean of these
    planes is closer to the surface. Near samples a mean would only flatten the fit.
    """

    reach: float = Field(
        0.011, ge=0, description="distance from the nearest sample beyond which values are smoothed, share of the width"
    )
    radius: int = Field(5, ge=0, le=50, description="half the side of the window, pixels")
    color_scale: float = Field(
        12.0, gt=0, description="color difference at which weights fall to exp(-1/2), grey levels"
    )

    def __call__(self, values: Floats, samples: Samples, image: Image8, wanted: Mask) -> Floats:
        """Return the map with ``wanted`` pixels far from ``samples`` smoothed; means leave out NaN."""
        height, width = values.shape
        selected = wanted & np.isfinite(values) & (samples.distance((height, width)) > self.reach * width)
        result = values.copy()
        run_bands(
            _smooth, height, values, image, selected, self.radius, np.float32(1.0 / (2.0 * self.color_scale**2)), result
        )
        return result


class RobustPlanes(TransparentPipeline):
    """Replace the sensor by planes through cleaned samples in the regions where it contradicts them (graph cut)."""

    renamed: ClassVar[dict[str, str]] = {"suspicion": "unreliable"}

    fit: SamplePlaneFit = Field(default_factory=SamplePlaneFit, description="planes through the samples")
    unreliable: UnreliableRegions = Field(
        default_factory=UnreliableRegions, description="regions where the sensor is unreliable"
    )
    smoothing: Smoothing = Field(
        default_factory=Smoothing, description="smoothing of the planes that replace the sensor"
    )

    def __call__(self, frame: SparseFrame) -> DepthResult:
        clock = Clock()
        fitted = fit_frame(frame, self.fit, self.unreliable, clock)
        clock.start("decode")
        kept = np.isfinite(fitted.sensor) & ~fitted.unreliable
        smooth = self.smoothing(fitted.fit, fitted.samples, frame.color, ~kept)
        values = np.where(kept, fitted.sensor, smooth)
        figures = {"samples": float(fitted.samples.values.size), "noise": fitted.noise}
        return refined_depth(frame, values, fitted.unreliable, clock, fitted.sampled(values), **figures)

    def peak_bytes(self, shape: tuple[int, int]) -> int:
        # neighbors of every pixel, and the graph of the cut
        return shape[0] * shape[1] * (4 * self.fit.neighbors + 700) + (64 << 20)


@jit
def _smooth(begin, end, values, image, wanted, radius, rate, result):
    height, width = values.shape
    for y in range(begin, end):
        for x in range(width):
            if not wanted[y, x]:
                continue
            total = weight = np.float32(0.0)
            for v in range(max(0, y - radius), min(height, y + radius + 1)):
                for u in range(max(0, x - radius), min(width, x + radius + 1)):
                    off = values[v, u] - values[y, x]
                    if np.isnan(off):
                        continue
                    color = np.float32(0.0)
                    for c in range(3):
                        step = np.float32(image[v, u, c]) - np.float32(image[y, x, c])
                        color += step * step
                    w = np.exp(-color * rate)
                    weight += w
                    total += w * off
            result[y, x] = values[y, x] + total / weight
