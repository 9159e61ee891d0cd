"""Bounds of the errors of a depth map, and the probability of a small one."""

from __future__ import annotations

from functools import cache

from depthcli.core.bound import DepthBound
from depthcli.core.frames import RgbdFrame, SparseFrame
from depthcli.core.maps import DepthMap, Floats
from depthcli.io.formats.networks import network_path, read_errors, read_network, read_numbers
from depthcli.methods.kinect.bounds import DepthErrors
from depthcli.methods.kinect.bounds import depth_bounds as kinect_bounds
from depthcli.methods.transparent.bounds import KINDS, GlassErrors, glass_bounds


@cache
def kinect_errors() -> DepthErrors:
    """Return the network and the table of the package."""
    return DepthErrors(read_network(network_path("depth_error")), read_errors("depth_errors"))


@cache
def glass_errors() -> GlassErrors:
    """Return the curves and tables of the package for completed depth."""
    return GlassErrors(read_numbers("glass_curves"), tuple(read_errors(f"glass_{kind}") for kind in KINDS))


def depth_bounds(frame: RgbdFrame, found: DepthMap, promise: DepthBound) -> tuple[Floats, Floats]:
    """Return bound, meters, NaN = no value, and probability of an error within ``promise.within``, of a frame's map."""
    if isinstance(frame, SparseFrame):
        return glass_bounds(glass_errors(), frame, found, promise.level, promise.within)
    return kinect_bounds(kinect_errors(), frame, found, promise.level, promise.within)
