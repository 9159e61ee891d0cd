"""Device implementation of :mod:`depthcli.methods.stereo.refinement.median`."""

from __future__ import annotations

from depthcli.device import Kernels
from depthcli.methods.stereo.on_device import DeviceContext, DeviceMap
from depthcli.methods.stereo.refinement.median import Median

_KERNELS = Kernels(__package__, "medians.cl")


def run(method: Median, disparity: DeviceMap, context: DeviceContext) -> DeviceMap:
    """Return the same map."""
    return disparity.refined(_KERNELS.with_macros(WINDOW=method.window), "plain_median")
