"""Device implementations of the optimizations; see :mod:`depthcli.methods.stereo._device_table`."""

from __future__ import annotations

import numpy as np

from depthcli.device import Kernels
from depthcli.methods.stereo.on_device import PIXELS, DevicePair, DeviceVolume
from depthcli.methods.stereo.optimization.scanline import Scanline
from depthcli.methods.stereo.optimization.winner_takes_all import WinnerTakesAll

_SCANLINE = Kernels(__name__, "scanline.cl")
_MEMORY_PARTS = 4  # path costs may take one part in so many of a GPU's memory


def scanline(method: Scanline, volume: DeviceVolume, pair: DevicePair) -> DeviceVolume:
    """Return the sums of path costs of :class:`Scanline`. As many directions run at a time as memory allows."""
    device = volume.device
    if volume.costs.dtype == np.float32:
        volume = volume.as_fixed_point()
    height, width, n_disparities = volume.costs.shape
    threads = 32
    while threads < min(n_disparities, 256):
        threads *= 2
    kernels = _SCANLINE.with_macros(COST=volume.c_type, ROOM=-(-n_disparities // threads) * threads, THREADS=threads)
    (p1, p2), (p1_edge, p2_edge) = method.penalties(volume.scale, volume.costs.dtype == np.uint8).tolist()
    edges = device.empty((4, height, width), np.uint8)
    device.launch(
        kernels, "path_edges", (width, height, 4), (*PIXELS, 1), pair.color[0], edges, height, width,
        method.edge_threshold,
    )  # fmt: skip
    total = device.empty(volume.costs.shape, np.uint16)
    room = device.info.memory // _MEMORY_PARTS if device.info.is_gpu else 0  # a CPU gains nothing from it
    at_once = max(1, min(method.paths, room // total.nbytes))
    sums = device.empty((at_once, *total.shape), np.uint16)
    for first in range(0, method.paths, at_once):
        count = min(at_once, method.paths - first)
        device.launch(
            kernels, "paths", ((width + height - 1) * threads, count), (threads, 1),
            volume.costs, edges, sums, height, width, n_disparities, first, p1, p2, p1_edge, p2_edge,
        )  # fmt: skip
        device.launch(
            kernels, "add_paths", (width * n_disparities, height), (256, 1),
            sums, total, width * n_disparities, height, count, int(first == 0),
        )  # fmt: skip
    return DeviceVolume(device, total, volume.scale * method.paths)


def winner_takes_all(method: WinnerTakesAll, volume: DeviceVolume, pair: DevicePair) -> DeviceVolume:
    """Return the costs unchanged."""
    return volume
