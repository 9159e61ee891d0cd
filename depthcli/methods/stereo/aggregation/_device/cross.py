"""Device implementation of :mod:`depthcli.methods.stereo.aggregation.cross`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

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


@dataclass(frozen=True)
class _Supports:
    """Arms of both views, (4, H, W) uint8, and the kernels for their lengths."""

    device: Device
    left: DeviceArray
    right: DeviceArray
    kernels: Kernels


def _aggregate(
    method: Cross,
    volume: DeviceVolume,
    pair: DevicePair,
    iteration: Callable[[_Supports, DeviceArray, int], DeviceArray],
) -> DeviceVolume:
    volume = fixed_point(volume)
    left = _arms(method, pair, pair.color[0])
    right = _arms(method, pair, pair.color[1]) if method.support == "intersection" else left
    shift = max(0, (FixedPoint.LARGEST * (2 * method.length + 1)).bit_length() - 16)
    supports = _Supports(volume.device, left, right, _KERNELS.with_macros(SHIFT=shift))
    costs = volume.costs
    for k in range(method.iterations):
        costs = iteration(supports, costs, int(k % 2 == 0))
    return DeviceVolume(volume.device, costs, volume.scale)


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


def _naive(supports: _Supports, costs: DeviceArray, across: int) -> DeviceArray:
    device, arms = supports.device, supports.left
    means = device.empty(costs.shape, np.uint16)
    inverse = _inverse(device, arms, across)
    device.launch(
        supports.kernels, "naive_cross", *cells(means), costs, arms, inverse, means, *costs.shape, across
    )  # fmt: skip
    return means


def _means(supports: _Supports, costs: DeviceArray, across: int) -> DeviceArray:
    device, arms = supports.device, supports.left
    inverse = _inverse(device, arms, across)
    sums = device.empty(costs.shape, np.uint32)
    for last, along in enumerate((across, 1 - across)):
        _prefix(device, supports.kernels, "prefix", costs, sums, along)
        out = device.empty(costs.shape, np.uint16)
        device.launch(supports.kernels, "spans", *cells(out), sums, arms, inverse, out, *costs.shape, along, last)
        costs = out
    return costs


def _naive_cut(supports: _Supports, costs: DeviceArray, across: int) -> DeviceArray:
    device, arms = supports.device, (supports.left, supports.right)
    means = device.empty(costs.shape, np.uint16)
    device.launch(_CUT, "naive_cut", *cells(means), costs, *arms, means, *costs.shape, across)
    return means


def _cut_means(supports: _Supports, costs: DeviceArray, across: int) -> DeviceArray:
    device, arms = supports.device, (supports.left, supports.right)
    sums, words = device.empty(costs.shape, np.uint32), device.empty(costs.shape, np.uint32)
    _prefix(device, _KERNELS, "prefix", costs, sums, across)
    device.launch(_CUT, "cut_spans", *cells(words), sums, *arms, words, *costs.shape, across)
    totals, means = device.empty(costs.shape, np.uint64), device.empty(costs.shape, np.uint16)
    _prefix(device, _CUT, "prefix_spans", words, totals, 1 - across)
    device.launch(_CUT, "cut_means", *cells(means), totals, *arms, means, *costs.shape, 1 - across)
    return means


def _inverse(device: Device, arms: DeviceArray, across: int) -> DeviceArray:
    _, height, width = arms.shape
    inverse = device.empty((height, width), np.float32)
    device.launch(_KERNELS, "inverse_areas", (width, height), PIXELS, arms, inverse, height, width, across)
    return inverse


def _prefix(device: Device, kernels: Kernels, name: str, source: DeviceArray, sums: DeviceArray, along: int) -> None:
    height, width, depth = source.shape
    lines, count = (height * depth, width) if along else (width * depth, height)
    device.launch(kernels, name, (lines,), (64,), source, sums, lines, width, depth, count, along)
