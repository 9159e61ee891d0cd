"""Joint bilateral inpainting, a baseline of the thesis."""

from __future__ import annotations

from depthcli.algorithms.filters import JointBilateral
from depthcli.core.frames import RgbdFrame
from depthcli.core.maps import Floats
from depthcli.methods.kinect.pipeline import FilterPipeline


class JointBilateralFill(JointBilateral, FilterPipeline):
    """Fill gaps with the mean of the known values around, weighted by distance and color similarity.

    Filling proceeds from a gap's rim inwards, until no window reaches another pixel.
    """

    def filtered(self, frame: RgbdFrame, measured: Floats, noise: float) -> Floats:
        return self.fill(frame.color, measured)
