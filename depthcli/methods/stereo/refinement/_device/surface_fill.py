"""Device implementation of :mod:`depthcli.methods.stereo.refinement.surface_fill`."""

from __future__ import annotations

import numpy as np

from depthcli.device import Kernels
from depthcli.methods.stereo.on_device import PIXELS, DeviceContext, DeviceMap
from depthcli.methods.stereo.refinement.surface_fill import SurfaceFill

_KERNELS = Kernels(__package__, "fills.cl")


def run(method: SurfaceFill, disparity: DeviceMap, context: DeviceContext) -> DeviceMap:
    """Return the same map, up to rounding where the device has no double precision."""
    height, width = disparity.values.shape
    real = np.float64 if disparity.device.has_double else np.float32
    planes = disparity.device.empty((height, width, 4), real)
    disparity.device.launch(
        _KERNELS, "surfaces_at_gaps", (width, height), PIXELS, disparity.values, planes, height, width,
        method.rows, method.reach, method.support,
    )  # fmt: skip
    return disparity.refined(_KERNELS, "continue_surfaces", [planes], float(context.volume.disparities - 1))
