"""Device implementation of :mod:`depthcli.methods.stereo.cost.absolute_difference`."""

from __future__ import annotations

from depthcli.methods.stereo.cost._device import fill_volume
from depthcli.methods.stereo.cost.absolute_difference import AbsoluteDifference
from depthcli.methods.stereo.on_device import DevicePair, DeviceVolume


def run(method: AbsoluteDifference, pair: DevicePair, disparities: int) -> DeviceVolume:
    """Return the same costs."""
    channels = 3 if pair.host.left.ndim == 3 else 1
    left, right = pair.color if channels == 3 else pair.grey8
    limit = min(round(method.truncation * channels), method.MAX_STORED)
    outside = min(round(method.outside * channels), limit)
    kernel = "tolerant_difference" if method.sampling == "tolerant" else "difference"
    costs = fill_volume(kernel, pair, left, right, disparities, outside, 0, limit, CHANNELS=channels)
    return DeviceVolume(pair.device, costs, float(channels))
