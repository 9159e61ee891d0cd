"""Device implementation of :mod:`depthcli.methods.stereo.aggregation.adaptive_weight`."""

from __future__ import annotations

import math

import numpy as np

from depthcli.device import Kernels
from depthcli.methods.stereo.aggregation.adaptive_weight import AdaptiveWeight
from depthcli.methods.stereo.on_device import DevicePair, DeviceVolume, cells

_KERNELS = Kernels(__package__, "adaptive_weight.cl")
_TILE, _LANES, _THREADS = 32, 64, 256


def run(method: AdaptiveWeight, volume: DeviceVolume, pair: DevicePair) -> DeviceVolume:
    """Return the same means but for rounding; weights are shared by a tile of pixels and disparities."""
    height, width, depth = volume.costs.shape
    size = (-(-width // _TILE) * _THREADS, -(-depth // _LANES), height)
    return _aggregate(method, volume, pair, "shared_weights", size, (_THREADS, 1, 1))


def naive(method: AdaptiveWeight, volume: DeviceVolume, pair: DevicePair) -> DeviceVolume:
    """Return the same means but for rounding; every cell computes all weights of its window."""
    return _aggregate(method, volume, pair, "naive_weights", *cells(volume.costs))


def _aggregate(
    method: AdaptiveWeight, volume: DeviceVolume, pair: DevicePair, kernel: str, size: tuple[int, int, int],
    group: tuple[int, int, int],
) -> DeviceVolume:  # fmt: skip
    device = volume.device
    whole = volume.costs.dtype != np.float32
    fixed_point = 16 if volume.costs.dtype == np.uint8 else 1
    means = device.empty(volume.costs.shape, np.uint16 if whole else np.float32)
    left, right = (device.upload(method.planes(image)) for image in pair.host.color8)
    out = "ushort" if whole else "float"
    kernels = _KERNELS.with_macros(COST=volume.c_type, OUT=out, SQUARED=int(method.norm == "squared"))
    rates = math.log2(math.e) / method.gamma_color, math.log2(math.e) / method.gamma_space
    device.launch(
        kernels, kernel, size, group, volume.costs, left, right, means, *means.shape, method.window // 2, *rates,
        float(fixed_point), 0.5 if whole else 0.0,
    )  # fmt: skip
    return DeviceVolume(device, means, volume.scale * fixed_point)
