"""Fixed-point means: how aggregated costs are stored.

Aggregation returns means over the support as uint16 with four fractional bits more than a uint8 cost has,
so that a mean never exceeds 255 * 16 = 4080 and eight path costs of a scanline optimizer fit into 16 bits.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from depthcli.core import memory
from depthcli.kernels.jit import parallel_jit, prange
from depthcli.methods.stereo.volume import CostVolume


class FixedPoint:
    """The format of aggregated costs."""

    FRACTION: ClassVar[int] = 16
    LARGEST: ClassVar[int] = 255 * 16


def as_fixed_point(volume: CostVolume) -> CostVolume:
    """The volume as uint16 fixed point, at most ``FixedPoint.LARGEST``; a float32 volume is scaled to fit."""
    costs = volume.costs
    if costs.dtype == np.uint16:
        return volume
    if costs.dtype == np.uint8:
        factor = float(FixedPoint.FRACTION)
    else:
        low, high = float(costs.min()), float(costs.max())
        if low < 0:
            costs, high = costs - np.float32(low), high - low
        factor = FixedPoint.LARGEST / high if high > 0 else 1.0
    fixed: NDArray[np.uint16] = memory.empty(costs.shape, np.uint16)
    _scale(costs, np.float32(factor), fixed)
    return CostVolume(fixed, volume.scale * factor)


@parallel_jit
def _scale(costs: Any, factor: Any, fixed: Any) -> None:
    height, width, depth = costs.shape
    half = np.float32(0.5)
    for y in prange(height):
        source = costs[y].reshape(width * depth)
        out = fixed[y].reshape(width * depth)
        for i in range(out.size):
            out[i] = np.uint16(np.int32(np.float32(source[i]) * factor + half))
