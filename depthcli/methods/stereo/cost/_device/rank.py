"""Device implementation of :mod:`depthcli.methods.stereo.cost.rank`."""

from __future__ import annotations

import numpy as np

from depthcli.methods.stereo.cost._device import fill_volume
from depthcli.methods.stereo.cost._device.census import window_feature
from depthcli.methods.stereo.cost.rank import Rank
from depthcli.methods.stereo.on_device import DevicePair, DeviceVolume


def run(method: Rank, pair: DevicePair, disparities: int) -> DeviceVolume:
    """Return the same costs."""
    left, right = (window_feature("rank", pair, image, method.window, np.uint8) for image in pair.grey)
    costs = fill_volume("difference", pair, left, right, disparities, round(method.outside), 0, 255, CHANNELS=1)
    return DeviceVolume(pair.device, costs, 1.0)
