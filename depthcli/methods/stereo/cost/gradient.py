"""Difference of image gradients (thesis, eq. 3.2)."""

from __future__ import annotations

from typing import ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.core import memory
from depthcli.core.frames import Image, StereoPair
from depthcli.core.maps import Doubles
from depthcli.methods.stereo.cost import CostMeasure, Sampling
from depthcli.methods.stereo.cost._fill import difference_volume
from depthcli.methods.stereo.volume import CostVolume, fill_outside


class Gradient(CostMeasure):
    """``|dI/dx - dI'/dx| + |dI/dy - dI'/dy|`` of the grey images, truncated; invariant to added constants.

    The 5 x 5 derivative-of-Gaussian filters are normalized so that a ramp of 1 grey level per pixel has derivative 1.
    """

    aliases = ("GRAD",)

    sigma: float = Field(1.0, ge=0.3, le=2, description="standard deviation of the derivative filter, pixels")
    truncation: float = Field(40.0, gt=0, le=63, description="largest gradient cost, grey levels per pixel")
    sampling: Sampling = "exact"
    outside: float = Field(
        4.0, ge=0, le=63, description="cost of a match outside the right image, grey levels per pixel"
    )

    SCALE: ClassVar[int] = 4
    compares_levels = True

    def halo(self) -> int | None:
        return 3 if self.sampling == "tolerant" else 2

    def __call__(self, pair: StereoPair, n_disparities: int) -> CostVolume:
        costs = memory.empty((*pair.shape, n_disparities), np.uint8)
        left, right = (image_gradient(image, self.sigma) for image in pair.grey)
        limit = round(self.truncation * self.SCALE)
        difference_volume(left, right, costs, limit, self.sampling, shift=2)  # sixteenths to quarters
        fill_outside(costs, np.uint8(min(limit, round(self.outside * self.SCALE))))
        return CostVolume(costs, float(self.SCALE))


def image_gradient(image: Image, sigma: float) -> NDArray[np.int16]:
    """Compute derivatives along x and y with a 5 x 5 derivative-of-Gaussian filter of ``sigma`` pixels.

    The border pixels of the image are repeated outwards. The result is (2, H, W) int16, in sixteenths of a grey level
    (of 255) per pixel.
    """
    smooth, slope = derivative_filters(sigma)
    grey = image.astype(np.float32) * np.float32(16 if image.dtype == np.uint8 else 16 / 257)
    border = cv2.BORDER_REPLICATE
    pairs = ((slope, smooth), (smooth, slope))
    derivatives = [cv2.sepFilter2D(grey, cv2.CV_32F, *kernels, borderType=border) for kernels in pairs]
    return np.rint(derivatives).astype(np.int16)


def derivative_filters(sigma: float) -> tuple[Doubles, Doubles]:
    """Return the five taps of a Gaussian and of its derivative, whose response to a ramp of 1 per pixel is 1."""
    offsets = np.arange(-2, 3)
    smooth = np.exp(-(offsets**2) / (2 * sigma**2))
    smooth = smooth / smooth.sum()
    slope = offsets * smooth
    return smooth, slope / (offsets * slope).sum()
