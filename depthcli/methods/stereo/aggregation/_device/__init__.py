"""Device implementations of the aggregations; see :mod:`depthcli.methods.stereo.on_device`.

Each has ``run``, made for the device, and ``naive``, a thread a cell that reads its window from global memory. They
are the two columns of the thesis's figure 3.2.
"""

from __future__ import annotations

import numpy as np

from depthcli.device import Kernels
from depthcli.methods.stereo.on_device import DeviceVolume
from depthcli.methods.stereo.volume import FixedPoint, as_fixed_point

_FIXED = Kernels(__name__, "fixed_point.cl")


def fixed_point(volume: DeviceVolume) -> DeviceVolume:
    """Convert costs as :func:`depthcli.methods.stereo.volume.as_fixed_point` does; float32 ones on the host."""
    if volume.costs.dtype == np.uint16:
        return volume
    if volume.costs.dtype == np.float32:
        return DeviceVolume.upload(volume.device, as_fixed_point(volume.download()))
    out = volume.device.empty(volume.costs.shape, np.uint16)
    height, width, depth = volume.costs.shape
    volume.device.launch(
        _FIXED, "to_fixed_point", (width * depth, height), (256, 1), volume.costs, out, width * depth, height,
        FixedPoint.FRACTION,
    )  # fmt: skip
    return DeviceVolume(volume.device, out, volume.scale * FixedPoint.FRACTION)
