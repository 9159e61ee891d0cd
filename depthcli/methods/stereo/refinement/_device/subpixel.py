"""Device implementation of :mod:`depthcli.methods.stereo.refinement.subpixel`."""

from __future__ import annotations

import numpy as np

from depthcli.device import Kernels
from depthcli.methods.stereo.on_device import PIXELS, DeviceContext, DeviceMap
from depthcli.methods.stereo.refinement.subpixel import Subpixel

_KERNELS = Kernels("depthcli.methods.stereo", "selection.cl")


def run(method: Subpixel, disparity: DeviceMap, context: DeviceContext) -> DeviceMap:
    """Return the same map; to a millionth of a pixel where the device has no double precision."""
    height, width, depth = context.volume.costs.shape
    values = disparity.device.empty((height, width), np.float32)
    disparity.device.launch(
        _KERNELS.with_macros(COST=context.volume.c_type), "move_to_minimum", (width, height), PIXELS,
        context.volume.costs, disparity.values, values, height, width, depth,
    )  # fmt: skip
    return DeviceMap(disparity.device, values, disparity.status)
