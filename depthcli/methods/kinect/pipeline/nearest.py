"""Gaps filled with the nearest known value, for comparison."""

from __future__ import annotations

from typing import ClassVar

from depthcli.core.frames import RgbdFrame
from depthcli.core.result import Clock
from depthcli.methods.kinect.disparity import nearest_fill
from depthcli.methods.kinect.pipeline import DisparityArray, FilterPipeline


class NearestFill(FilterPipeline):
    """Every gap pixel takes the disparity of the nearest known one; measured values stay."""

    bytes_per_pixel: ClassVar[int] = 50

    def filtered(self, frame: RgbdFrame, measured: DisparityArray, noise: float, clock: Clock) -> DisparityArray:
        clock.start("fill")
        return nearest_fill(measured)
