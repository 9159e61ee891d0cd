"""The types that the stages of a pipeline pass to each other on a device; running a stage there."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np

from depthcli.core.frames import StereoPair
from depthcli.core.maps import DisparityMap
from depthcli.device import Device, DeviceArray, Kernels
from depthcli.methods.stereo.volume import CostVolume, FixedPoint, RefinementContext, as_fixed_point

Table: TypeAlias = Mapping[type, Callable[..., Any]]
"""Class of a method -> its device implementation, see :mod:`._device_table`."""

PIXELS = (32, 8)
"""Threads of a group, along x and y, of kernels with one thread per pixel."""

_CONVERSIONS = Kernels("depthcli.methods.stereo", "conversions.cl")


@dataclass(frozen=True)
class DevicePair:
    """A pair in host memory, whose images are copied to a device when they are first used."""

    device: Device
    host: StereoPair
    table: Table

    @property
    def shape(self) -> tuple[int, int]:
        """Return (H, W)."""
        return self.host.shape

    @cached_property
    def color(self) -> tuple[DeviceArray, DeviceArray]:
        """Return both images, (H, W, 3) uint8."""
        left, right = self.host.color8
        return self.device.upload(left), self.device.upload(right)

    @cached_property
    def grey(self) -> tuple[DeviceArray, DeviceArray]:
        """Return both images, (H, W) luma as :attr:`StereoPair.grey`."""
        height, width = self.shape
        if self.host.left.ndim < 3 or self.host.left.dtype != np.uint8 or self.host.bits not in (None, 8):
            left, right = self.host.grey
            return self.device.upload(left), self.device.upload(right)
        views = self.device.empty((height, width), np.uint16), self.device.empty((height, width), np.uint16)
        for image, grey in zip(self.color, views, strict=True):
            self.device.launch(_CONVERSIONS, "luma", (width, height), PIXELS, image, grey, height, width)
        return views

    @cached_property
    def grey8(self) -> tuple[DeviceArray, DeviceArray]:
        """Return both images, (H, W) uint8."""
        if self.grey[0].dtype == np.uint8:
            return self.grey
        left, right = self.host.grey8
        return self.device.upload(left), self.device.upload(right)

    def run(self, stage: Any, *arguments: Any) -> Any:
        """Run a stage by its device implementation or, if it has none, on the CPU, with transfers.

        ``arguments`` are the arguments of the stage's ``__call__``, as types of this module.
        """
        if implementation := self.table.get(type(stage)):
            return implementation(stage, *arguments)

        def on_host(argument: Any) -> Any:
            if isinstance(argument, DevicePair | DeviceContext):
                return argument.host
            return argument.download() if isinstance(argument, DeviceVolume | DeviceMap) else argument

        result = stage(*map(on_host, arguments))
        kind = DeviceVolume if isinstance(result, CostVolume) else DeviceMap
        return kind.upload(self.device, result)


@dataclass(frozen=True)
class DeviceVolume:
    """A :class:`~depthcli.methods.stereo.volume.CostVolume` on a device: (H, W, D) uint8, uint16 or float32."""

    device: Device
    costs: DeviceArray
    scale: float = 1.0

    @property
    def n_disparities(self) -> int:
        """Return D, the number of disparities."""
        return self.costs.shape[2]

    @property
    def c_type(self) -> str:
        """Return the costs' type in C."""
        return c_type(self.costs.dtype)

    def download(self) -> CostVolume:
        """Copy the volume to the host."""
        return CostVolume(self.device.download(self.costs), self.scale)

    def as_fixed_point(self) -> DeviceVolume:
        """Convert costs as :func:`depthcli.methods.stereo.volume.as_fixed_point` does; float32 ones on the host."""
        if self.costs.dtype == np.uint16:
            return self
        if self.costs.dtype == np.float32:
            return DeviceVolume.upload(self.device, as_fixed_point(self.download()))
        fixed = self.device.empty(self.costs.shape, np.uint16)
        height, width, n_disparities = self.costs.shape
        self.device.launch(
            _CONVERSIONS, "to_fixed_point", (width * n_disparities, height), (256, 1),
            self.costs, fixed, width * n_disparities, height, FixedPoint.FRACTION,
        )  # fmt: skip
        return DeviceVolume(self.device, fixed, self.scale * FixedPoint.FRACTION)

    @classmethod
    def upload(cls, device: Device, volume: CostVolume) -> DeviceVolume:
        """Copy ``volume`` to the device."""
        return cls(device, device.upload(volume.costs), volume.scale)


@dataclass(frozen=True)
class DeviceMap:
    """A :class:`~depthcli.core.maps.DisparityMap` on a device: (H, W) float32 and uint8."""

    device: Device
    values: DeviceArray
    status: DeviceArray

    def download(self) -> DisparityMap:
        """Copy the map to the host."""
        return DisparityMap(self.device.download(self.values), self.device.download(self.status))

    def refined(self, kernels: Kernels, name: str, inputs: Sequence[DeviceArray] = (), *parameters: Any) -> DeviceMap:
        """Return the map that a kernel with one thread per pixel computes from this one.

        The kernel's arguments are values and status of this map, ``inputs``, the new values and status, H, W, and
        ``parameters``.
        """
        new = DeviceMap.empty(self.device, self.values.shape)
        height, width = self.values.shape
        self.device.launch(
            kernels, name, (width, height), PIXELS, self.values, self.status, *inputs, new.values, new.status,
            height, width, *parameters,
        )  # fmt: skip
        return new

    @classmethod
    def empty(cls, device: Device, shape: Sequence[int]) -> DeviceMap:
        """Return an uninitialized map of (H, W) ``shape``."""
        return cls(device, device.empty(shape, np.float32), device.empty(shape, np.uint8))

    @classmethod
    def upload(cls, device: Device, disparity: DisparityMap) -> DeviceMap:
        """Copy ``disparity`` to the device."""
        return cls(device, device.upload(disparity.values), device.upload(disparity.status))


@dataclass(frozen=True)
class DeviceContext:
    """A :class:`~depthcli.methods.stereo.volume.RefinementContext` on a device."""

    pair: DevicePair
    volume: DeviceVolume
    right: DeviceArray

    @cached_property
    def host(self) -> RefinementContext:
        """Return the context on the host, for steps without a device implementation."""
        return RefinementContext(self.pair.host, self.volume.download(), self.pair.device.download(self.right))


def c_type(dtype: Any) -> str:
    """Return the C name of a NumPy type that kernels take."""
    return {"uint8": "uchar", "uint16": "ushort", "int16": "short", "float32": "float"}[np.dtype(dtype).name]


def cells(volume: DeviceArray) -> tuple[tuple[int, int, int], tuple[int, int, int]]:
    """Return size and group of a launch with one thread per cell of an (H, W, D) array, d fastest."""
    height, width, n_disparities = volume.shape
    lanes = 16
    while lanes < min(n_disparities, 64):
        lanes *= 2
    return (n_disparities, width, height), (lanes, 256 // lanes, 1)
