"""Restoration of first disparities on surfaces that are not planar."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.core.method import ConfigModel
from depthcli.kernels.winners import winners
from depthcli.methods.stereo.segments.first_estimate import FirstEstimate
from depthcli.methods.stereo.volume import CostVolume

_STEP = 1.0  # pixels: an estimate further from the median of its 3 x 3 neighbors is noise


class Restoration(ConfigModel):
    """Restore first disparities in areas where they are dense, smooth, and off the plane.

    A fold of cloth has one color, but needs more planes than its segments have. Its first disparities are trusted and
    smooth; on a bare wall they are neither. Narrow areas keep their plane: windows and scanlines widen objects, and
    the rims would come back.
    """

    radius: int = Field(
        0, ge=0, le=64, description="radius of the smallest disc that is restored, pixels; 0: nothing is restored"
    )
    difference: float = Field(
        1.0, gt=0, le=16384, description="distance from the plane above which a pixel is off the plane, pixels"
    )
    density: float = Field(0.9, ge=0, le=1, description="least share of trusted, smooth pixels in the window")
    window: int = Field(9, ge=1, le=129, description="side of the window, pixels")

    def __call__(self, values: NDArray[np.float32], first: FirstEstimate, volume: CostVolume) -> NDArray[np.float32]:
        """Return ``values`` (H, W), pixels, with first disparities where they are restored.

        ``volume`` is the one whose cheapest disparities are in ``first``; parabolas through its costs give fractions.
        """
        if self.radius == 0:
            return values
        fine = np.empty(values.shape, np.float32)
        whole = winners(volume.costs, fine)[0].astype(np.float32)
        sure = first.trusted & (np.abs(fine - cv2.medianBlur(whole, 3)) <= _STEP)
        size = (self.window, self.window)
        dense = cv2.blur(sure.astype(np.float32), size, borderType=cv2.BORDER_REFLECT) >= np.float32(
            self.density - 1e-6
        )
        off = np.abs(fine - values) > self.difference
        area = (dense & (off | ~sure)).astype(np.uint8)
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * self.radius + 1, 2 * self.radius + 1))
        wide = cv2.morphologyEx(area, cv2.MORPH_OPEN, disc) != 0
        return np.where(wide & sure & off, fine, values)
