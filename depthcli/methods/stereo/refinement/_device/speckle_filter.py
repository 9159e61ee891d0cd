"""Device implementation of :mod:`depthcli.methods.stereo.refinement.speckle_filter`."""

from __future__ import annotations

import numpy as np

from depthcli.device import Kernels
from depthcli.methods.stereo.on_device import PIXELS, DeviceContext, DeviceMap
from depthcli.methods.stereo.refinement.speckle_filter import SpeckleFilter, steps_of

_KERNELS = Kernels(__package__, "speckles.cl")


def run(method: SpeckleFilter, disparity: DeviceMap, context: DeviceContext) -> DeviceMap:
    """Return the same map: regions by union of trees (Playne and Hawick 2018)."""
    device = disparity.device
    height, width = disparity.values.shape
    count, steps = height * width, steps_of(context.volume.disparities)
    fixed = device.empty((height, width), np.int16)
    parent, roots, sizes = (device.empty((height, width), np.int32) for _ in range(3))
    all_pixels = ((count,), (256,))
    device.launch(_KERNELS, "start_regions", *all_pixels, disparity.values, fixed, parent, sizes, count, steps)
    largest = round(method.step * steps)
    device.launch(_KERNELS, "join_regions", (width, height), PIXELS, fixed, parent, height, width, largest)
    device.launch(_KERNELS, "count_regions", *all_pixels, parent, roots, sizes, count)
    out = DeviceMap.empty(device, (height, width))
    device.launch(
        _KERNELS, "remove_small", *all_pixels, disparity.values, disparity.status, roots, sizes, out.values, out.status,
        count, method.size,
    )  # fmt: skip
    return out
