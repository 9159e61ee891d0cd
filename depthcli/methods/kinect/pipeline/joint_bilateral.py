"""Joint bilateral inpainting, which the thesis compares with."""

from __future__ import annotations

from pydantic import Field

from depthcli.algorithms.filters import joint_bilateral_fill
from depthcli.core.frames import RgbdFrame
from depthcli.core.maps import Floats
from depthcli.core.method import Odd
from depthcli.methods.kinect.pipeline import FilterPipeline


class JointBilateralFill(FilterPipeline):
    """Fill every gap with the mean of the known values around, weighted by distance and similarity of color.

    Repeated from the gap's rim inwards, until nothing is left that a window can reach.
    """

    window: Odd = Field(21, ge=3, le=101, description="side of the window, pixels, odd")
    sigma_space: float = Field(5.0, gt=0, description="standard deviation of the weight by distance, pixels")
    sigma_color: float = Field(15.0, gt=0, description="standard deviation of the weight by color, grey levels")

    def filtered(self, frame: RgbdFrame, measured: Floats, noise: float) -> Floats:
        return joint_bilateral_fill(frame.color, measured, self.window, self.sigma_space, self.sigma_color)
