"""The device implementation of the local pipeline."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from depthcli.core.context import Clock, Context
from depthcli.core.errors import InputError
from depthcli.core.text import show_bytes
from depthcli.device import DeviceArray, Kernels
from depthcli.kernels.winners import winners
from depthcli.methods.confidence import confidence_maps
from depthcli.methods.stereo.adjustment import adjusted
from depthcli.methods.stereo.on_device import DeviceContext, DeviceMap, DevicePair, DeviceVolume
from depthcli.methods.stereo.pipeline.local import Local
from depthcli.methods.stereo.volume import StereoResult

_KERNELS = Kernels("depthcli.methods.stereo", "selection.cl")
_LANES, _PIXELS = 32, 8  # threads of a group along the disparities; pixels of a group


def local(method: Local, pair: DevicePair, max_disparity: int, context: Context | None = None) -> StereoResult:
    """Match a pair over disparities 0 .. ``max_disparity`` inclusive. Raise InputError if device memory is short.

    Stages without a device implementation run on the CPU, with transfers; ``figures["stages_on_cpu"]`` counts them. The
    pair is adjusted, and confidence is measured, on the CPU.
    """
    device, info, clock = pair.device, pair.device.info, Clock()
    need = _device_bytes(method, pair.shape, max_disparity)
    if need > info.memory:
        raise InputError(
            f"needs about {show_bytes(need)} on {info.address} ({info.name}), which has {show_bytes(info.memory)}; "
            "see device, max_disparity"
        )
    pair = replace(pair, host=adjusted(pair.host, max_disparity, method.adjust, context, clock))

    def start(stage: str) -> None:
        device.finish()
        clock.start(stage)

    start("cost")
    volume: DeviceVolume = pair.run(method.cost, pair, max_disparity + 1)
    start("aggregation")
    if method.aggregation is not None:
        volume = pair.run(method.aggregation, volume, pair)
    start("optimization")
    volume = pair.run(method.optimization, volume, pair)
    left, right = _winners(volume)
    disparity = DeviceMap.empty(device, left.shape)
    device.launch(_KERNELS, "start_map", (left.size,), (256,), left, disparity.values, disparity.status, left.size)
    start("refinement")
    seen = DeviceContext(pair, volume, right)
    for step in method.refinement:
        disparity = pair.run(step, disparity, seen)
    found = disparity.download()
    clock.start("confidence")
    maps = confidence_maps(device.download(volume.costs), method.confidence) if method.confidence else {}
    stages = [method.cost, method.aggregation, method.optimization, *method.refinement]
    on_cpu = sum(stage is not None and type(stage) not in pair.table for stage in stages)
    return StereoResult(found, seconds=clock.seconds, confidence=maps, figures={"stages_on_cpu": float(on_cpu)})


def _device_bytes(method: Local, shape: tuple[int, int], max_disparity: int) -> int:
    # Bytes of the volumes, with one direction of scanlines at a time, and of the maps.
    intersects = getattr(method.aggregation, "support", "") == "intersection"
    bytes_per_cell = 18 if intersects else 10 if method.aggregation is not None else 7
    return shape[0] * shape[1] * ((max_disparity + 1) * bytes_per_cell + 100)


def _winners(volume: DeviceVolume) -> tuple[DeviceArray, DeviceArray]:
    device = volume.device
    if volume.costs.dtype == np.float32:
        left, right = winners(device.download(volume.costs))
        return device.upload(left), device.upload(right)
    height, width, n_disparities = volume.costs.shape
    found = []
    for diagonal in (0, 1):
        best = device.empty((height, width), np.uint16)
        device.launch(
            _KERNELS.with_macros(COST=volume.c_type), "winners", (_LANES, width, height), (_LANES, _PIXELS, 1),
            volume.costs, best, height, width, n_disparities, diagonal,
        )  # fmt: skip
        found.append(best)
    return found[0], found[1]
