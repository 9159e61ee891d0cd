"""Bounds of the errors of a depth map, and the probability of a small one."""

from __future__ import annotations

from functools import cache
from statistics import NormalDist

import numpy as np

from depthcli.core.bound import DepthBound
from depthcli.core.frames import RgbdFrame, SparseFrame
from depthcli.core.maps import Floats
from depthcli.core.result import DepthResult
from depthcli.io.formats.networks import network_path, read_errors, read_network
from depthcli.methods.kinect.bounds import DepthErrors
from depthcli.methods.kinect.bounds import depth_bounds as kinect_bounds


@cache
def kinect_errors() -> DepthErrors:
    """Return the network and the table of the package."""
    return DepthErrors(read_network(network_path("depth_error")), read_errors("depth_errors"))


def depth_bounds(frame: RgbdFrame, found: DepthResult, promise: DepthBound) -> tuple[Floats, Floats]:
    """Return bound, meters, NaN = no value, and probability of an error within ``promise.within``, of a frame's map."""
    if not isinstance(frame, SparseFrame):
        return kinect_bounds(kinect_errors(), frame, found.depth, promise.level, promise.within)
    deviation = np.full(frame.shape, np.nan, np.float32) if found.deviation is None else found.deviation
    bound = np.float32(NormalDist().inv_cdf((1 + promise.level) / 2)) * deviation
    probability: Floats = (1 - np.exp(-0.5 * (promise.within / deviation) ** 2)).astype(np.float32)
    return bound, np.where(np.isnan(deviation), np.float32(0), probability)
