"""Colors of a frame in CIE Lab, and color differences."""

from __future__ import annotations

import cv2
import numpy as np

from depthcli.core.frames import RgbdFrame
from depthcli.core.maps import Image8
from depthcli.kernels.jit import helper


def frame_lab(frame: RgbdFrame) -> Image8:
    """Return the color image in CIE Lab with OpenCV's scaling, (H, W, 3) uint8."""
    return np.asarray(cv2.cvtColor(frame.color, cv2.COLOR_RGB2Lab), np.uint8)


@helper
def lab_difference(lab, y, x, v, u):
    """Return the L1 difference of the colors of pixels (y, x) and (v, u), int32."""
    difference = np.int32(0)
    for i in range(3):
        difference += abs(np.int32(lab[y, x, i]) - np.int32(lab[v, u, i]))
    return difference
