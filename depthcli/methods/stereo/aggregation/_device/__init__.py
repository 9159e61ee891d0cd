"""Device implementations of the aggregations; see :mod:`depthcli.methods.stereo.on_device`.

Each has a second version, ``naive_...``: one thread per cell, which reads its window from global memory. The two are
the columns of a figure (thesis, figure 3.2). Both return the same means as the method, unless the docstring says
otherwise.
"""

from __future__ import annotations

import math

import numpy as np

from depthcli.device import Device, DeviceArray, Kernels
from depthcli.methods.stereo.aggregation.adaptive_weight import AdaptiveWeight
from depthcli.methods.stereo.aggregation.constant_window import ConstantWindow
from depthcli.methods.stereo.aggregation.cross import Cross
from depthcli.methods.stereo.on_device import PIXELS, DevicePair, DeviceVolume, cells
from depthcli.methods.stereo.volume import FixedPoint

_WEIGHTS, _WINDOW, _CROSS, _CUT = (
    Kernels(__name__, f"{file}.cl") for file in ("adaptive_weight", "constant_window", "cross", "intersection")
)
_TILE, _LANES, _THREADS = 32, 64, 256  # pixels and disparities of a group of adaptive weights, and its threads
_BAND = 64  # rows or columns that one thread's running sum goes along; each starts with a window's sum


def adaptive_weight(method: AdaptiveWeight, volume: DeviceVolume, pair: DevicePair) -> DeviceVolume:
    """Return the means of :class:`AdaptiveWeight` but for rounding; a tile of pixels and disparities shares weights."""
    height, width, n_disparities = volume.costs.shape
    size = (-(-width // _TILE) * _THREADS, -(-n_disparities // _LANES), height)
    return _weighted_means(method, volume, pair, "shared_weights", size, (_THREADS, 1, 1))


def naive_adaptive_weight(method: AdaptiveWeight, volume: DeviceVolume, pair: DevicePair) -> DeviceVolume:
    """Return the means of :class:`AdaptiveWeight` but for rounding; every cell computes all weights of its window."""
    return _weighted_means(method, volume, pair, "naive_weights", *cells(volume.costs))


def _weighted_means(
    method: AdaptiveWeight, volume: DeviceVolume, pair: DevicePair, kernel: str, size: tuple[int, int, int],
    group: tuple[int, int, int],
) -> DeviceVolume:  # fmt: skip
    device = volume.device
    whole = volume.costs.dtype != np.float32
    factor = 16 if volume.costs.dtype == np.uint8 else 1
    means = device.empty(volume.costs.shape, np.uint16 if whole else np.float32)
    left, right = (device.upload(method.planes(image)) for image in pair.host.color8)
    out = "ushort" if whole else "float"
    kernels = _WEIGHTS.with_macros(COST=volume.c_type, OUT=out, SQUARED=int(method.norm == "squared"))
    rates = math.log2(math.e) / method.gamma_color, math.log2(math.e) / method.gamma_space
    device.launch(
        kernels, kernel, size, group, volume.costs, left, right, means, *means.shape, method.window // 2, *rates,
        float(factor), 0.5 if whole else 0.0,
    )  # fmt: skip
    return DeviceVolume(device, means, volume.scale * factor)


def constant_window(method: ConstantWindow, volume: DeviceVolume, pair: DevicePair) -> DeviceVolume:
    """Return the means of :class:`ConstantWindow`, by two running sums."""
    if volume.costs.dtype != np.uint8:
        volume = volume.as_fixed_point()
    device = volume.device
    height, width, n_disparities = volume.costs.shape
    radius = method.window // 2
    narrow = np.iinfo(volume.costs.dtype).max * method.window < 1 << 16
    kernels = _WINDOW.with_macros(COST=volume.c_type, SUM="ushort" if narrow else "uint")
    sums = device.empty(volume.costs.shape, np.uint16 if narrow else np.uint32)
    means = device.empty(volume.costs.shape, np.uint16)
    band = max(_BAND, method.window)
    device.launch(
        kernels, "column_sums", (width * n_disparities, -(-height // band)), (256, 1),
        volume.costs, sums, height, width * n_disparities, radius, band,
    )  # fmt: skip
    (lanes, columns, _), _ = cells(means)
    device.launch(
        kernels, "row_means", (lanes, -(-columns // band), height), (cells(means)[1][0], 1, 4),
        sums, means, height, width, n_disparities, radius, float(_factor(volume)), band,
    )  # fmt: skip
    return DeviceVolume(device, means, volume.scale * _factor(volume))


def naive_constant_window(method: ConstantWindow, volume: DeviceVolume, pair: DevicePair) -> DeviceVolume:
    """Return the means of :class:`ConstantWindow`, each summed anew."""
    if volume.costs.dtype != np.uint8:
        volume = volume.as_fixed_point()
    device = volume.device
    means = device.empty(volume.costs.shape, np.uint16)
    kernels = _WINDOW.with_macros(COST=volume.c_type, SUM="uint")
    device.launch(
        kernels, "naive_window", *cells(means), volume.costs, means, *means.shape, method.window // 2,
        float(_factor(volume)),
    )  # fmt: skip
    return DeviceVolume(device, means, volume.scale * _factor(volume))


def _factor(volume: DeviceVolume) -> int:
    return FixedPoint.FRACTION if volume.costs.dtype == np.uint8 else 1


def cross(method: Cross, volume: DeviceVolume, pair: DevicePair) -> DeviceVolume:
    """Return the means of :class:`Cross`, by orthogonal integrals."""
    volume = volume.as_fixed_point()
    device, costs = volume.device, volume.costs
    kernels, arms = _kernels_and_arms(method, pair)
    for k in range(method.iterations):
        across = int(k % 2 == 0)
        sums = device.empty(costs.shape, np.uint32)
        if method.support == "intersection":
            _prefix(device, _CROSS, "prefix", costs, sums, across)
            words = device.empty(costs.shape, np.uint32)
            device.launch(_CUT, "cut_spans", *cells(words), sums, *arms, words, *costs.shape, across)
            totals, means = device.empty(costs.shape, np.uint64), device.empty(costs.shape, np.uint16)
            _prefix(device, _CUT, "prefix_spans", words, totals, 1 - across)
            device.launch(_CUT, "cut_means", *cells(means), totals, *arms, means, *costs.shape, 1 - across)
            costs = means
            continue
        inverse = _inverse(device, arms[0], across)
        for last, along in enumerate((across, 1 - across)):
            _prefix(device, kernels, "prefix", costs, sums, along)
            out = device.empty(costs.shape, np.uint16)
            device.launch(kernels, "spans", *cells(out), sums, arms[0], inverse, out, *costs.shape, along, last)
            costs = out
    return DeviceVolume(device, costs, volume.scale)


def naive_cross(method: Cross, volume: DeviceVolume, pair: DevicePair) -> DeviceVolume:
    """Return the means of :class:`Cross`, every support summed anew."""
    volume = volume.as_fixed_point()
    device, costs = volume.device, volume.costs
    kernels, arms = _kernels_and_arms(method, pair)
    for k in range(method.iterations):
        across, means = int(k % 2 == 0), device.empty(costs.shape, np.uint16)
        if method.support == "intersection":
            device.launch(_CUT, "naive_cut", *cells(means), costs, *arms, means, *costs.shape, across)
        else:
            inverse = _inverse(device, arms[0], across)
            device.launch(kernels, "naive_cross", *cells(means), costs, arms[0], inverse, means, *costs.shape, across)
        costs = means
    return DeviceVolume(device, costs, volume.scale)


def _kernels_and_arms(method: Cross, pair: DevicePair) -> tuple[Kernels, list[DeviceArray]]:
    """Return the kernels for the lengths of arms, and the (4, H, W) uint8 arms of the views that count."""
    device = pair.device
    height, width = pair.shape
    all_arms = []
    for image in pair.color if method.support == "intersection" else pair.color[:1]:
        if method.smoothing:
            smooth = device.empty(image.shape, np.uint8)
            device.launch(_CROSS, "median_3", (width, height), PIXELS, image, smooth, height, width)
            image = smooth
        arms = device.empty((4, height, width), np.uint8)
        limits = method.length, method.threshold, method.inner_length, method.inner_threshold
        device.launch(_CROSS, "grow_arms", (width, height, 4), (*PIXELS, 1), image, arms, height, width, *limits)
        all_arms.append(arms)
    shift = max(0, (FixedPoint.LARGEST * (2 * method.length + 1)).bit_length() - 16)
    return _CROSS.with_macros(SHIFT=shift), all_arms


def _inverse(device: Device, arms: DeviceArray, across: int) -> DeviceArray:
    _, height, width = arms.shape
    inverse = device.empty((height, width), np.float32)
    device.launch(_CROSS, "inverse_areas", (width, height), PIXELS, arms, inverse, height, width, across)
    return inverse


def _prefix(device: Device, kernels: Kernels, name: str, source: DeviceArray, sums: DeviceArray, along: int) -> None:
    height, width, n_disparities = source.shape
    lines, count = (height * n_disparities, width) if along else (width * n_disparities, height)
    device.launch(kernels, name, (lines,), (64,), source, sums, lines, width, n_disparities, count, along)
