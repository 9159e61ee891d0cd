"""Device implementation of :mod:`depthcli.methods.stereo.refinement.weighted_median`."""

from __future__ import annotations

import numpy as np

from depthcli.device import Kernels
from depthcli.methods.stereo.on_device import PIXELS, DeviceContext, DeviceMap
from depthcli.methods.stereo.refinement.weighted_median import WeightedMedian

_KERNELS = Kernels(__package__, "medians.cl")


def run(method: WeightedMedian, disparity: DeviceMap, context: DeviceContext) -> DeviceMap:
    """Return the same map, up to a bin of 1/8 pixel where half of the weights is reached in one order of sums alone."""
    device = disparity.device
    height, width = disparity.values.shape
    by_color, by_distance = (device.upload(table) for table in method.tables())
    values = disparity.values
    for _ in range(method.passes):
        filtered = device.empty((height, width), np.float32)
        device.launch(
            _KERNELS, "weighted_median", (width, height), PIXELS, context.pair.color[0], values, disparity.status,
            by_color, by_distance, filtered, height, width, method.radius, float(method.filled_weight),
        )  # fmt: skip
        values = filtered
    status = device.empty((height, width), np.uint8)
    count = height * width
    device.launch(_KERNELS, "mark_changes", (count,), (256,), disparity.values, values, disparity.status, status, count)
    return DeviceMap(device, values, status)
