"""Twin of :mod:`depthcli.methods.stereo.refinement.surface_fill`."""

from __future__ import annotations

import numpy as np

from depthcli.device import Kernels
from depthcli.methods.stereo.on_device import PIXELS, DeviceEvidence, DeviceMap, map_like
from depthcli.methods.stereo.refinement.surface_fill import SurfaceFill

_KERNELS = Kernels(__package__, "fills.cl")


def run(method: SurfaceFill, disparity: DeviceMap, evidence: DeviceEvidence) -> DeviceMap:
    """The same map; but for rounding where the device has no double precision."""
    height, width = disparity.values.shape
    real = np.float64 if disparity.device.has_double else np.float32
    planes = disparity.device.empty((height, width, 4), real)
    size = (width, height), PIXELS
    disparity.device.launch(
        _KERNELS, "surfaces_at_gaps", *size, disparity.values, planes, height, width,
        method.rows, method.reach, method.support,
    )  # fmt: skip
    out = map_like(disparity)
    disparity.device.launch(
        _KERNELS, "continue_surfaces", *size, disparity.values, disparity.status, planes, out.values, out.status,
        height, width, float(evidence.volume.disparities - 1),
    )  # fmt: skip
    return out
