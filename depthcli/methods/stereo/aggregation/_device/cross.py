"""Device implementation of :mod:`depthcli.methods.stereo.aggregation.cross`."""

from __future__ import annotations

import numpy as np

from depthcli.device import Device, DeviceArray, Kernels
from depthcli.methods.stereo.aggregation._device import fixed_point
from depthcli.methods.stereo.aggregation.cross import Cross
from depthcli.methods.stereo.on_device import PIXELS, DevicePair, DeviceVolume, cells
from depthcli.methods.stereo.volume import FixedPoint

_KERNELS = Kernels(__package__, "cross.cl")
_CUT = Kernels(__package__, "intersection.cl")


def run(method: Cross, volume: DeviceVolume, pair: DevicePair) -> DeviceVolume:
    """Return the same means, by orthogonal integrals."""
    return _aggregate(method, volume, pair, _cut_means if method.support == "intersection" else _means)


def naive(method: Cross, volume: DeviceVolume, pair: DevicePair) -> DeviceVolume:
    """Return the same means, every support summed anew."""
    return _aggregate(method, volume, pair, _naive_cut if method.support == "intersection" else _naive)


def _aggregate(method: Cross, volume: DeviceVolume, pair: DevicePair, once: object) -> DeviceVolume:
    volume = fixed_point(volume)
    arms = _arms(method, pair, pair.color[0])
    other = _arms(method, pair, pair.color[1]) if method.support == "intersection" else arms
    source = volume.costs
    for iteration in range(method.iterations):
        source = once(method, volume.device, source, arms, other, int(iteration % 2 == 0))  # type: ignore[operator]
    return DeviceVolume(volume.device, source, volume.scale)


def _arms(method: Cross, pair: DevicePair, image: DeviceArray) -> DeviceArray:
    height, width = pair.shape
    device = pair.device
    if method.smoothing:
        smooth = device.empty(image.shape, np.uint8)
        device.launch(_KERNELS, "median_3", (width, height), PIXELS, image, smooth, height, width)
        image = smooth
    arms = device.empty((4, height, width), np.uint8)
    device.launch(
        _KERNELS, "grow_arms", (width, height, 4), (*PIXELS, 1), image, arms, height, width,
        method.length, method.threshold, method.inner_length, method.inner_threshold,
    )  # fmt: skip
    return arms


def _kernels(method: Cross) -> Kernels:
    return _KERNELS.with_macros(SHIFT=max(0, (FixedPoint.LARGEST * (2 * method.length + 1)).bit_length() - 16))


def _inverse(device: Device, arms: DeviceArray, across: int) -> DeviceArray:
    _, height, width = arms.shape
    inverse = device.empty((height, width), np.float32)
    device.launch(_KERNELS, "inverse_areas", (width, height), PIXELS, arms, inverse, height, width, across)
    return inverse


def _naive(
    method: Cross, device: Device, source: DeviceArray, arms: DeviceArray, other: DeviceArray, across: int
) -> DeviceArray:
    means = device.empty(source.shape, np.uint16)
    inverse = _inverse(device, arms, across)
    device.launch(_kernels(method), "naive_cross", *cells(means), source, arms, inverse, means, *source.shape, across)
    return means


def _means(
    method: Cross, device: Device, source: DeviceArray, arms: DeviceArray, other: DeviceArray, across: int
) -> DeviceArray:
    kernels = _kernels(method)
    inverse = _inverse(device, arms, across)
    sums = device.empty(source.shape, np.uint32)
    for last, along in enumerate((across, 1 - across)):
        _prefix(device, kernels, "prefix", source, sums, along)
        out = device.empty(source.shape, np.uint16)
        device.launch(kernels, "spans", *cells(out), sums, arms, inverse, out, *source.shape, along, last)
        source = out
    return source


def _prefix(device: Device, kernels: Kernels, name: str, source: DeviceArray, sums: DeviceArray, along: int) -> None:
    height, width, depth = source.shape
    lines, count = (height * depth, width) if along else (width * depth, height)
    device.launch(kernels, name, (lines,), (64,), source, sums, lines, width, depth, count, along)


def _naive_cut(
    method: Cross, device: Device, source: DeviceArray, arms: DeviceArray, other: DeviceArray, across: int
) -> DeviceArray:
    means = device.empty(source.shape, np.uint16)
    device.launch(_CUT, "naive_cut", *cells(means), source, arms, other, means, *source.shape, across)
    return means


def _cut_means(
    method: Cross, device: Device, source: DeviceArray, arms: DeviceArray, other: DeviceArray, across: int
) -> DeviceArray:
    sums, words = device.empty(source.shape, np.uint32), device.empty(source.shape, np.uint32)
    _prefix(device, _CUT, "prefix_costs", source, sums, across)
    device.launch(_CUT, "cut_spans", *cells(words), sums, arms, other, words, *source.shape, across)
    totals, means = device.empty(source.shape, np.uint64), device.empty(source.shape, np.uint16)
    _prefix(device, _CUT, "prefix_spans", words, totals, 1 - across)
    device.launch(_CUT, "cut_means", *cells(means), totals, arms, other, means, *source.shape, 1 - across)
    return means
