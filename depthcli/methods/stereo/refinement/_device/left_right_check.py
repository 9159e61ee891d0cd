"""Device implementation of :mod:`depthcli.methods.stereo.refinement.left_right_check`."""

from __future__ import annotations

from depthcli.device import Kernels
from depthcli.methods.stereo.on_device import DeviceContext, DeviceMap
from depthcli.methods.stereo.refinement.left_right_check import LeftRightCheck

_KERNELS = Kernels("depthcli.methods.stereo", "selection.cl")


def run(method: LeftRightCheck, disparity: DeviceMap, context: DeviceContext) -> DeviceMap:
    """Return the same map."""
    parameters = context.volume.disparities, float(method.tolerance)
    return disparity.refined(_KERNELS, "left_right_check", [context.right], *parameters)
