"""Twin of :mod:`depthcli.methods.stereo.refinement.background_fill`."""

from __future__ import annotations

import numpy as np

from depthcli.device import Kernels
from depthcli.methods.stereo.on_device import PIXELS, DeviceEvidence, DeviceMap, map_like
from depthcli.methods.stereo.refinement.background_fill import BackgroundFill

_KERNELS = Kernels(__package__, "fills.cl")


def run(method: BackgroundFill, disparity: DeviceMap, evidence: DeviceEvidence) -> DeviceMap:
    """The same map."""
    height, width = disparity.values.shape
    rows = disparity.device.empty((height, width), np.float32)
    size = (width, height), PIXELS
    disparity.device.launch(_KERNELS, "fill_rows", *size, disparity.values, rows, height, width)
    out = map_like(disparity)
    disparity.device.launch(
        _KERNELS, "fill_columns", *size, disparity.values, disparity.status, rows, out.values, out.status, height, width
    )
    return out
