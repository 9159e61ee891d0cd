"""Twin of :mod:`depthcli.methods.stereo.refinement.left_right_check`."""

from __future__ import annotations

from depthcli.device import Kernels
from depthcli.methods.stereo.on_device import PIXELS, DeviceEvidence, DeviceMap, map_like
from depthcli.methods.stereo.refinement.left_right_check import LeftRightCheck

_KERNELS = Kernels("depthcli.methods.stereo", "selection.cl")


def run(method: LeftRightCheck, disparity: DeviceMap, evidence: DeviceEvidence) -> DeviceMap:
    """The same map."""
    height, width = disparity.values.shape
    out = map_like(disparity)
    disparity.device.launch(
        _KERNELS, "left_right_check", (width, height), PIXELS, disparity.values, disparity.status, evidence.right,
        out.values, out.status, height, width, evidence.volume.disparities, float(method.tolerance),
    )  # fmt: skip
    return out
