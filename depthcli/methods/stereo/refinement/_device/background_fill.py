"""Device implementation of :mod:`depthcli.methods.stereo.refinement.background_fill`."""

from __future__ import annotations

import numpy as np

from depthcli.device import Kernels
from depthcli.methods.stereo.on_device import PIXELS, DeviceContext, DeviceMap
from depthcli.methods.stereo.refinement.background_fill import BackgroundFill

_KERNELS = Kernels(__package__, "fills.cl")


def run(method: BackgroundFill, disparity: DeviceMap, context: DeviceContext) -> DeviceMap:
    """Return the same map."""
    height, width = disparity.values.shape
    rows = disparity.device.empty((height, width), np.float32)
    disparity.device.launch(_KERNELS, "fill_rows", (width, height), PIXELS, disparity.values, rows, height, width)
    return disparity.refined(_KERNELS, "fill_columns", [rows])
