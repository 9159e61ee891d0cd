"""Joint bilateral inpainting, a baseline of the thesis."""

from __future__ import annotations

from pydantic import Field

from depthcli.algorithms.filters import joint_bilateral_fill
from depthcli.core.frames import RgbdFrame
from depthcli.core.maps import Floats
from depthcli.core.method import Odd
from depthcli.methods.kinect.pipeline import FilterPipeline


class JointBilateralFill(FilterPipeline):
    """Fill gaps with the mean of the known values around, weighted by distance and color similarity.

    Filling proceeds from a gap's rim inwards, until no window reaches another pixel.
    """

    window: Odd = Field(21, ge=3, le=101, description="side of the window, pixels, odd")
    sigma_space: float = Field(5.0, gt=0, description="standard deviation of the weight by distance, pixels")
    sigma_color: float = Field(15.0, gt=0, description="standard deviation of the weight by color, grey levels")

    def filtered(self, frame: RgbdFrame, measured: Floats, noise: float) -> Floats:
        return joint_bilateral_fill(frame.color, measured, self.window, self.sigma_space, self.sigma_color)
