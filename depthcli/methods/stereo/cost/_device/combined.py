"""Device implementation of :mod:`depthcli.methods.stereo.cost.combined`."""

from __future__ import annotations

import numpy as np

from depthcli.device import Kernels
from depthcli.methods.stereo.cost import light_weights
from depthcli.methods.stereo.cost.combined import Combined, part_shares
from depthcli.methods.stereo.on_device import DevicePair, DeviceVolume, run_stage

_KERNELS = Kernels(__package__, "combined.cl")


def run(method: Combined, pair: DevicePair, disparities: int) -> DeviceVolume:
    """Return the same costs; a part without a device implementation is computed on the host."""
    height, width = pair.shape
    device = pair.device
    unit = 255 // len(method.parts)
    outside = min(255, round(method.outside * unit))
    total = device.empty((height, width, disparities), np.uint8)
    weights = light_weights([part.cost for part in method.parts], pair.host)
    if weights is None:
        weights = np.ones((len(method.parts), height, width), np.float32)
    for k, part in enumerate(method.parts):
        units = device.upload(np.float32(unit) * weights[k])
        volume: DeviceVolume = run_stage(part.cost, pair, disparities)
        table = device.upload(part_shares(volume.scale * part.lambda_))
        last = k == len(method.parts) - 1
        device.launch(
            _KERNELS, "add_part", (width * disparities, height), (256, 1),
            volume.costs, table, units, total, int(k == 0), disparities, width, outside, int(last), height,
        )  # fmt: skip
    return DeviceVolume(device, total, float(unit))
