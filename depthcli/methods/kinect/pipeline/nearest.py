"""Gaps filled with the nearest known value, for comparison."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from depthcli.core.frames import RgbdFrame
from depthcli.core.result import Clock
from depthcli.methods.kinect.disparity import nearest_fill
from depthcli.methods.kinect.pipeline import FilterPipeline


class Nearest(FilterPipeline):
    """Every gap pixel takes the disparity of the nearest known one; measured values stay."""

    bytes_per_pixel: ClassVar[int] = 50

    def filtered(
        self, frame: RgbdFrame, measured: NDArray[np.float32], noise: float, clock: Clock
    ) -> NDArray[np.float32]:
        values = nearest_fill(measured)
        clock.stop("fill")
        return values
