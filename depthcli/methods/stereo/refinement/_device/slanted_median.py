"""Device implementation of :mod:`depthcli.methods.stereo.refinement.slanted_median`, slopes included."""

from __future__ import annotations

import numpy as np

from depthcli.algorithms.plane_fitting.window_slopes import BLOCK, difference_limits
from depthcli.device import DeviceArray, Kernels
from depthcli.methods.stereo.on_device import PIXELS, DeviceContext, DeviceMap
from depthcli.methods.stereo.refinement.slanted_median import SlantedMedian

_KERNELS = Kernels(__package__, "slanted.cl")
_MEDIANS = Kernels(__package__, "medians.cl")


def run(method: SlantedMedian, disparity: DeviceMap, context: DeviceContext) -> DeviceMap:
    """Return the same map."""
    device = disparity.device
    height, width = disparity.values.shape
    count = height * width
    image = context.pair.color[0]
    known, trust = device.empty((height, width), np.float32), device.empty((height, width), np.float32)
    device.launch(_KERNELS, "split_values", (count,), (256,), disparity.values, known, trust, count)
    gradient = _slopes(known, trust, image, method.slope_radius, context)
    distance, rate = method.weights()
    distances = device.upload(distance)
    for _ in range(method.passes):
        out = device.empty((height, width), np.float32)
        device.launch(
            _KERNELS, "slanted_median", (width, height), (BLOCK, 1), image, known, trust, gradient, distances, out,
            height, width, method.radius, rate, float(context.volume.disparities - 1),
        )  # fmt: skip
        known = out
    values, status = device.empty((height, width), np.float32), device.empty((height, width), np.uint8)
    device.launch(_KERNELS, "join_values", (count,), (256,), disparity.values, known, values, count)
    device.launch(_MEDIANS, "mark_changes", (count,), (256,), disparity.values, values, disparity.status, status, count)
    return DeviceMap(device, values, status)


def _slopes(
    known: DeviceArray, trust: DeviceArray, image: DeviceArray, radius: int, context: DeviceContext
) -> DeviceArray:
    # As :func:`depthcli.algorithms.plane_fitting.window_slopes.slopes`, (2, H, W).
    device = context.pair.device
    height, width = known.shape
    step, limits, spread = difference_limits(radius)
    found = device.empty((2, height, width), np.float32)
    device.launch(
        _KERNELS, "slopes", (width, height), PIXELS, known, trust, image, device.upload(limits), found, height, width,
        step, spread,
    )  # fmt: skip
    return found
