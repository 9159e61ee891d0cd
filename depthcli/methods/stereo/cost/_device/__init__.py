"""Device implementations of the cost measures; see :mod:`depthcli.methods.stereo.on_device`."""

from __future__ import annotations

from typing import Any

import numpy as np

from depthcli.device import DeviceArray, Kernels
from depthcli.methods.stereo.on_device import DevicePair, cells

_FILL = Kernels(__name__, "fill.cl")


def fill_volume(
    kernel: str, pair: DevicePair, left: DeviceArray, right: DeviceArray, disparities: int, outside: int, *more: Any,
    **macros: Any,
) -> DeviceArray:  # fmt: skip
    """Compute an (H, W, D) uint8 volume from two feature images by a kernel of ``fill.cl``."""
    height, width = pair.shape
    costs = pair.device.empty((height, width, disparities), np.uint8)
    kernels = _FILL.with_macros(**macros) if macros else _FILL
    pair.device.launch(kernels, kernel, *cells(costs), left, right, costs, height, width, disparities, outside, *more)
    return costs
