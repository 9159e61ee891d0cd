"""Device implementation of :mod:`depthcli.methods.stereo.aggregation.constant_window`."""

from __future__ import annotations

import numpy as np

from depthcli.device import Kernels
from depthcli.methods.stereo.aggregation._device import fixed_point
from depthcli.methods.stereo.aggregation.constant_window import ConstantWindow
from depthcli.methods.stereo.on_device import DevicePair, DeviceVolume, cells
from depthcli.methods.stereo.volume import FixedPoint

_KERNELS = Kernels(__package__, "constant_window.cl")
_BAND = 64  # rows or columns that one thread's running sum goes along; each starts with a window's sum


def run(method: ConstantWindow, volume: DeviceVolume, pair: DevicePair) -> DeviceVolume:
    """Return the same means, by two running sums."""
    if volume.costs.dtype != np.uint8:
        volume = fixed_point(volume)
    device = volume.device
    height, width, depth = volume.costs.shape
    radius = method.window // 2
    narrow = np.iinfo(volume.costs.dtype).max * method.window < 1 << 16
    kernels = _KERNELS.with_macros(COST=volume.c_type, SUM="ushort" if narrow else "uint")
    sums = device.empty(volume.costs.shape, np.uint16 if narrow else np.uint32)
    means = device.empty(volume.costs.shape, np.uint16)
    band = max(_BAND, method.window)
    device.launch(
        kernels, "column_sums", (width * depth, -(-height // band)), (256, 1),
        volume.costs, sums, height, width * depth, radius, band,
    )  # fmt: skip
    (lanes, columns, _), _ = cells(means)
    device.launch(
        kernels, "row_means", (lanes, -(-columns // band), height), (cells(means)[1][0], 1, 4),
        sums, means, height, width, depth, radius, float(_factor(volume)), band,
    )  # fmt: skip
    return DeviceVolume(device, means, volume.scale * _factor(volume))


def naive(method: ConstantWindow, volume: DeviceVolume, pair: DevicePair) -> DeviceVolume:
    """Return the same means, each summed anew."""
    if volume.costs.dtype != np.uint8:
        volume = fixed_point(volume)
    device = volume.device
    means = device.empty(volume.costs.shape, np.uint16)
    kernels = _KERNELS.with_macros(COST=volume.c_type, SUM="uint")
    device.launch(
        kernels, "naive_window", *cells(means), volume.costs, means, *means.shape, method.window // 2,
        float(_factor(volume)),
    )  # fmt: skip
    return DeviceVolume(device, means, volume.scale * _factor(volume))


def _factor(volume: DeviceVolume) -> int:
    return FixedPoint.FRACTION if volume.costs.dtype == np.uint8 else 1
