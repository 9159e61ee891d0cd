"""Color and infrared images of two cameras, with the depth that a sensor measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from depthcli.core.cameras.rig import Rig
from depthcli.core.frames import RgbdFrame


@dataclass(frozen=True)
class RgbIrFrame:
    """A color image, an infrared one, and the depth that a sensor measured for the color image's pixels.

    ``rig`` has the color (left) and the infrared camera (right); without one the images are a rectified pair of one
    size, with ``fb``, focal length x baseline in pixel meters.
    """

    color: NDArray[np.uint8]  # (H, W, 3) RGB
    infrared: NDArray[np.uint8]  # (h, w)
    depth: NDArray[np.float32]  # (H, W), meters, NaN = unknown; registered to ``color``
    rig: Rig | None = None
    fb: float = 1.0

    def __post_init__(self) -> None:
        RgbdFrame(self.color, self.depth)
        if self.infrared.ndim != 2 or self.infrared.dtype != np.uint8:
            raise ValueError(f"expected (h, w) uint8 infrared, got {self.infrared.shape} {self.infrared.dtype}")
        if self.rig is None and self.infrared.shape != self.depth.shape:
            raise ValueError(f"a rectified pair has one size, got {self.depth.shape} and {self.infrared.shape}")
