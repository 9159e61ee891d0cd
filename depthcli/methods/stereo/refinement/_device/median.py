"""Twin of :mod:`depthcli.methods.stereo.refinement.median`."""

from __future__ import annotations

from depthcli.device import Kernels
from depthcli.methods.stereo.on_device import PIXELS, DeviceEvidence, DeviceMap, map_like
from depthcli.methods.stereo.refinement.median import Median

_KERNELS = Kernels(__package__, "medians.cl")


def run(method: Median, disparity: DeviceMap, evidence: DeviceEvidence) -> DeviceMap:
    """The same map."""
    height, width = disparity.values.shape
    out = map_like(disparity)
    disparity.device.launch(
        _KERNELS.with_macros(WINDOW=method.window), "plain_median", (width, height), PIXELS,
        disparity.values, disparity.status, out.values, out.status, height, width,
    )  # fmt: skip
    return out
