"""Device implementation of :mod:`depthcli.methods.stereo.cost.census`."""

from __future__ import annotations

import numpy as np

from depthcli.device import DeviceArray, Kernels
from depthcli.methods.stereo.cost._device import fill_volume
from depthcli.methods.stereo.cost.census import Census
from depthcli.methods.stereo.on_device import PIXELS, DevicePair, DeviceVolume, c_type

FEATURES = Kernels(__package__, "features.cl")


def run(method: Census, pair: DevicePair, disparities: int) -> DeviceVolume:
    """Return the same costs."""
    left, right = (window_feature("census", pair, image, method.window, np.uint64) for image in pair.grey)
    costs = fill_volume("hamming", pair, left, right, disparities, round(method.outside))
    return DeviceVolume(pair.device, costs, 1.0)


def window_feature(
    kernel: str, pair: DevicePair, image: DeviceArray, window: tuple[int, int], dtype: type
) -> DeviceArray:
    """Compute a feature image by a kernel of ``features.cl`` over the window of every pixel."""
    height, width = pair.shape
    out = pair.device.empty((height, width), dtype)
    kernels = FEATURES.with_macros(GREY=c_type(image.dtype))
    radii = window[1] // 2, window[0] // 2
    pair.device.launch(kernels, kernel, (width, height), PIXELS, image, out, height, width, *radii)
    return out
