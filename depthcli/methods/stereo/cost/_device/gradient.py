"""Device implementation of :mod:`depthcli.methods.stereo.cost.gradient`."""

from __future__ import annotations

import numpy as np

from depthcli.device import DeviceArray
from depthcli.methods.stereo.cost._device import fill_volume
from depthcli.methods.stereo.cost._device.census import FEATURES
from depthcli.methods.stereo.cost.gradient import Gradient, derivative_filters
from depthcli.methods.stereo.on_device import PIXELS, DevicePair, DeviceVolume, c_type


def run(method: Gradient, pair: DevicePair, disparities: int) -> DeviceVolume:
    """Return the same costs, up to the rounding of derivatives in single precision: a sixteenth of a grey level."""
    left, right = (_derivatives(method, pair, image) for image in pair.grey)
    limit = round(method.truncation * method.SCALE)
    outside = min(limit, round(method.outside * method.SCALE))
    kernel = "tolerant_difference" if method.sampling == "tolerant" else "difference"
    costs = fill_volume(kernel, pair, left, right, disparities, outside, 2, limit, FEATURE="short", CHANNELS=2)
    return DeviceVolume(pair.device, costs, float(method.SCALE))


def _derivatives(method: Gradient, pair: DevicePair, image: DeviceArray) -> DeviceArray:
    height, width = pair.shape
    smooth, slope = (pair.device.upload(taps.astype(np.float32)) for taps in derivative_filters(method.sigma))
    out = pair.device.empty((height, width, 2), np.int16)
    unit = 16.0 if image.dtype == np.uint8 else 16 / 257
    kernels = FEATURES.with_macros(GREY=c_type(image.dtype))
    pair.device.launch(kernels, "gradient", (width, height), PIXELS, image, smooth, slope, unit, out, height, width)
    return out
