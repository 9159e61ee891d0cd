"""Gaps filled with the nearest known value, for comparison."""

from __future__ import annotations

from depthcli.core.frames import RgbdFrame
from depthcli.core.maps import Floats
from depthcli.methods.kinect.disparity import nearest_fill
from depthcli.methods.kinect.pipeline import FilterPipeline


class NearestFill(FilterPipeline):
    """Fill every gap pixel with the disparity of the nearest known pixel; keep measured values."""

    def filtered(self, frame: RgbdFrame, measured: Floats, noise: float) -> Floats:
        return nearest_fill(measured)
