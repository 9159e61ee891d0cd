"""Twin of :mod:`depthcli.methods.stereo.pipeline.local`: from the two images to the map on a device."""

from __future__ import annotations

import numpy as np

from depthcli.core.frames import StereoPair
from depthcli.core.method import Method, twin_of
from depthcli.core.result import Clock
from depthcli.device import Device, DeviceArray, Kernels
from depthcli.kernels.winners import winners
from depthcli.methods.confidence import confidence_maps
from depthcli.methods.stereo.adjustment import adjusted
from depthcli.methods.stereo.on_device import DeviceEvidence, DeviceMap, DevicePair, DeviceVolume
from depthcli.methods.stereo.pipeline.local import Local
from depthcli.methods.stereo.volume import StereoResult

_KERNELS = Kernels("depthcli.methods.stereo", "selection.cl")
_LANES, _PIXELS = 32, 8


def run(method: Local, pair: StereoPair, max_disparity: int, device: Device) -> StereoResult:
    """Match ``pair`` over disparities 0 .. ``max_disparity`` inclusive.

    Stages without a twin run on the processor, with transfers; ``figures["stages_on_cpu"]`` counts them. The pair is
    adjusted, and confidence measured, on the processor.
    """
    clock = Clock()
    there = DevicePair(device, adjusted(pair, max_disparity, method.adjust, clock))
    volume = _cost(method, there, max_disparity + 1)
    _stop(clock, "cost", device)
    stages: list[Method] = [method.cost]
    if method.aggregation is not None:
        volume = _volume_stage(method.aggregation, volume, there)
        stages.append(method.aggregation)
    _stop(clock, "aggregation", device)
    volume = _volume_stage(method.optimization, volume, there)
    left, right = _winners(volume)
    disparity = _start(device, left)
    _stop(clock, "optimization", device)
    evidence = DeviceEvidence(there, volume, right)
    for step in method.refinement:
        twin = twin_of(step)
        if twin is not None:
            disparity = twin.run(step, disparity, evidence)
        else:
            disparity = DeviceMap.upload(device, step(disparity.download(), evidence.host))
    found = disparity.download()
    clock.stop("refinement")
    maps = confidence_maps(device.download(volume.costs), method.confidence) if method.confidence else {}
    clock.stop("confidence")
    stages += [method.optimization, *method.refinement]
    figures = {"stages_on_cpu": float(sum(twin_of(stage) is None for stage in stages))}
    return StereoResult(found, seconds=clock.seconds, confidence=maps, figures=figures)


def peak_bytes(method: Local, shape: tuple[int, int], max_disparity: int, device: Device) -> int:
    """Estimate of the memory that is needed on the device, where scanlines run one after another."""
    pixels = shape[0] * shape[1]
    cut = method.aggregation is not None and getattr(method.aggregation, "support", "") == "intersection"
    bytes_a_cell = 18 if cut else 10 if method.aggregation is not None else 7
    return pixels * (max_disparity + 1) * bytes_a_cell + 100 * pixels


def _stop(clock: Clock, stage: str, device: Device) -> None:
    device.finish()
    clock.stop(stage)


def _cost(method: Local, pair: DevicePair, disparities: int) -> DeviceVolume:
    twin = twin_of(method.cost)
    if twin is None:
        return DeviceVolume.upload(pair.device, method.cost(pair.host, disparities))
    volume: DeviceVolume = twin.run(method.cost, pair, disparities)
    return volume


def _volume_stage(stage: Method, volume: DeviceVolume, pair: DevicePair) -> DeviceVolume:
    twin = twin_of(stage)
    if twin is None:
        return DeviceVolume.upload(pair.device, stage(volume.download(), pair.host))  # type: ignore[operator]
    found: DeviceVolume = twin.run(stage, volume, pair)
    return found


def _winners(volume: DeviceVolume) -> tuple[DeviceArray, DeviceArray]:
    device = volume.device
    if volume.costs.dtype == np.float32:
        left, right = winners(device.download(volume.costs))
        return device.upload(left), device.upload(right)
    height, width, depth = volume.costs.shape
    found = []
    for diagonal in (0, 1):
        best = device.empty((height, width), np.uint16)
        device.launch(
            _KERNELS.with_macros(COST=volume.c_type), "winners", (_LANES, width, height), (_LANES, _PIXELS, 1),
            volume.costs, best, height, width, depth, diagonal,
        )  # fmt: skip
        found.append(best)
    return found[0], found[1]


def _start(device: Device, best: DeviceArray) -> DeviceMap:
    disparity = DeviceMap(device, device.empty(best.shape, np.float32), device.empty(best.shape, np.uint8))
    device.launch(_KERNELS, "start_map", (best.size,), (256,), best, disparity.values, disparity.status, best.size)
    return disparity
