"""Device implementations of the aggregations; see :mod:`depthcli.methods.stereo._device_table`.

Each returns the same means as the method of its name, unless its docstring states otherwise.
"""

from __future__ import annotations

import math

import numpy as np

from depthcli.device import DeviceArray, Kernels
from depthcli.methods.stereo.aggregation.adaptive_weight import AdaptiveWeight
from depthcli.methods.stereo.aggregation.constant_window import ConstantWindow
from depthcli.methods.stereo.aggregation.cross import LARGEST_DIFFERENCE, Cross
from depthcli.methods.stereo.on_device import PIXELS, DevicePair, DeviceVolume, cells
from depthcli.methods.stereo.volume import FixedPoint

_WEIGHTS, _WINDOW, _CROSS = (
    Kernels(__name__, f"{name}.cl") for name in ("adaptive_weight", "constant_window", "cross")
)
_TILE, _LANES, _THREADS = 32, 64, 256  # adaptive weights: pixels, disparities and threads of a group
_BAND = 64  # rows or columns of a thread's running sum, which begins with the sum over a window


def adaptive_weight(method: AdaptiveWeight, volume: DeviceVolume, pair: DevicePair) -> DeviceVolume:
    """Return the means of :class:`AdaptiveWeight`, up to rounding; a tile of pixels and disparities shares weights."""
    device = volume.device
    height, width, n_disparities = volume.costs.shape
    whole = volume.costs.dtype != np.float32
    factor = 16 if volume.costs.dtype == np.uint8 else 1
    means = device.empty(volume.costs.shape, np.uint16 if whole else np.float32)
    left, right = (device.upload(method.planes(image)) for image in pair.host.color8)
    out = "ushort" if whole else "float"
    kernels = _WEIGHTS.with_macros(COST=volume.c_type, OUT=out, SQUARED=int(method.norm == "squared"))
    rates = math.log2(math.e) / method.gamma_color, math.log2(math.e) / method.gamma_space
    size = (-(-width // _TILE) * _THREADS, -(-n_disparities // _LANES), height)
    device.launch(
        kernels, "shared_weights", size, (_THREADS, 1, 1), volume.costs, left, right, means, *means.shape,
        method.window // 2, *rates, float(factor), 0.5 if whole else 0.0,
    )  # fmt: skip
    return DeviceVolume(device, means, volume.scale * factor)


def constant_window(method: ConstantWindow, volume: DeviceVolume, pair: DevicePair) -> DeviceVolume:
    """Return the means of :class:`ConstantWindow`, by two running sums."""
    if volume.costs.dtype != np.uint8:
        volume = volume.as_fixed_point()
    device = volume.device
    height, width, n_disparities = volume.costs.shape
    radius = method.window // 2
    factor = FixedPoint.FRACTION if volume.costs.dtype == np.uint8 else 1
    narrow = np.iinfo(volume.costs.dtype).max * method.window < 1 << 16
    kernels = _WINDOW.with_macros(COST=volume.c_type, SUM="ushort" if narrow else "uint")
    sums = device.empty(volume.costs.shape, np.uint16 if narrow else np.uint32)
    means = device.empty(volume.costs.shape, np.uint16)
    band = max(_BAND, method.window)
    device.launch(
        kernels, "column_sums", (width * n_disparities, -(-height // band)), (256, 1),
        volume.costs, sums, height, width * n_disparities, radius, band,
    )  # fmt: skip
    device.launch(
        kernels, "row_means", (n_disparities, -(-width // band), height), (cells(means)[1][0], 1, 4),
        sums, means, height, width, n_disparities, radius, float(factor), band,
    )  # fmt: skip
    return DeviceVolume(device, means, volume.scale * factor)


def cross(method: Cross, volume: DeviceVolume, pair: DevicePair) -> DeviceVolume:
    """Return the means of :class:`Cross`, by orthogonal integral images."""
    volume = volume.as_fixed_point()
    device, costs = volume.device, volume.costs
    height, width, n_disparities = costs.shape
    shift = max(0, (FixedPoint.LARGEST * (2 * method.length + 1)).bit_length() - 16)
    kernels = _CROSS.with_macros(SHIFT=shift)
    arms = []
    for image in pair.color if method.support == "intersection" else pair.color[:1]:
        if method.smoothing:
            smooth = device.empty(image.shape, np.uint8)
            device.launch(kernels, "median_3", (width, height), PIXELS, image, smooth, height, width)
            image = smooth
        arms.append(device.empty((4, height, width), np.uint8))
        step_threshold = method.threshold if method.consecutive else LARGEST_DIFFERENCE
        limits = method.length, method.threshold, method.inner_length, method.inner_threshold, step_threshold
        device.launch(kernels, "grow_arms", (width, height, 4), (*PIXELS, 1), image, arms[-1], height, width, *limits)

    def prefix(name: str, source: DeviceArray, sums: DeviceArray, along: int) -> None:
        lines, count = (height * n_disparities, width) if along else (width * n_disparities, height)
        device.launch(kernels, name, (lines,), (64,), source, sums, lines, width, n_disparities, count, along)

    for k in range(method.iterations):
        across = int(k % 2 == 0)
        sums = device.empty(costs.shape, np.uint32)
        if method.support == "intersection":
            prefix("prefix", costs, sums, across)
            words = device.empty(costs.shape, np.uint32)
            device.launch(kernels, "cut_spans", *cells(words), sums, *arms, words, *costs.shape, across)
            totals, means = device.empty(costs.shape, np.uint64), device.empty(costs.shape, np.uint16)
            prefix("prefix_spans", words, totals, 1 - across)
            device.launch(kernels, "cut_means", *cells(means), totals, *arms, means, *costs.shape, 1 - across)
            costs = means
            continue
        inverse = device.empty((height, width), np.float32)
        device.launch(kernels, "inverse_areas", (width, height), PIXELS, arms[0], inverse, height, width, across)
        for last, along in enumerate((across, 1 - across)):
            prefix("prefix", costs, sums, along)
            out = device.empty(costs.shape, np.uint16)
            device.launch(kernels, "spans", *cells(out), sums, arms[0], inverse, out, *costs.shape, along, last)
            costs = out
    return DeviceVolume(device, costs, volume.scale)
