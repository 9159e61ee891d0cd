"""First disparities of the segment-based pipeline: windows inside segments, winner-takes-all, left-right check."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.core import memory
from depthcli.kernels.jit import jit, parallel_jit, prange
from depthcli.kernels.winners import left_right_difference, winners
from depthcli.methods.stereo.refinement.subpixel import move_to_minimum
from depthcli.methods.stereo.segments import Step
from depthcli.methods.stereo.volume import CostVolume, FixedPoint, as_fixed_point


@dataclass(frozen=True)
class FirstEstimate:
    """Disparities before planes are fitted.

    Attributes
    ----------
    values : (H, W) float32, pixels, may have fractions
    trusted : (H, W) bool: the right view agrees
    right : (H, W) uint16 disparities of the right view
    """

    values: NDArray[np.float32]
    trusted: NDArray[np.bool_]
    right: NDArray[np.uint16]


class Selection(Step):
    """Take the cheapest disparities of both views and check whether they agree.

    A pixel is trusted where the views agree and its costs are not all the same: in a uniform image every disparity
    would pass the check.
    """

    tolerance: float = Field(
        1.0, ge=0, le=16384, description="largest difference of the views at a trusted pixel, pixels"
    )
    subpixel: bool = Field(False, description="move disparities to the minimum of a parabola through three costs")

    def __call__(self, volume: CostVolume) -> FirstEstimate:
        left, right = winners(volume.costs)
        trusted = left_right_difference(left, right) <= self.tolerance
        _distrust_constant_costs(volume.costs, trusted)
        values = left.astype(np.float32)
        if self.subpixel:
            move_to_minimum(volume.costs, values)
        return FirstEstimate(values, trusted, right)


def segment_window(volume: CostVolume, labels: NDArray[np.int32], radius: int) -> CostVolume:
    """Average costs over those pixels of a square window that lie in the segment of its center.

    Returns
    -------
    CostVolume
        uint16 fixed point; a unit of a uint8 volume becomes 16.
    """
    fixed = as_fixed_point(volume) if volume.costs.dtype != np.uint8 else volume
    out = memory.empty(fixed.costs.shape, np.uint16)
    refinement = FixedPoint.FRACTION if volume.costs.dtype == np.uint8 else 1
    # Up to 257 uint8 costs fit into a uint16 sum, which is twice as fast.
    small = volume.costs.dtype == np.uint8 and (2 * radius + 1) ** 2 <= 257
    total = np.zeros(1, np.uint16 if small else np.uint32)
    _segment_window(fixed.costs, labels, radius, np.float32(refinement), total, out)
    return CostVolume(out, fixed.scale * refinement)


@parallel_jit
def _segment_window(costs, labels, radius, refinement, kind, out):
    height, width, n_disparities = costs.shape
    half = np.float32(0.5)
    for y in prange(height):
        total = np.zeros(n_disparities, kind.dtype)
        for x in range(width):
            total[:] = 0
            label = labels[y, x]
            count = 0
            for j in range(max(0, y - radius), min(height, y + radius + 1)):
                for k in range(max(0, x - radius), min(width, x + radius + 1)):
                    if labels[j, k] != label:
                        continue
                    count += 1
                    row = costs[j, k]
                    for i in range(total.size):
                        total[i] += row[i]
            factor = refinement / np.float32(count)
            target = out[y, x]
            for i in range(total.size):
                target[i] = np.uint16(np.int32(np.float32(total[i]) * factor + half))


def has_information(volume: CostVolume) -> bool:
    """Return whether any pixel has different costs inside the right image; in a uniform image none has."""
    return bool(_has_information(volume.costs))


@jit
def _has_information(costs):
    height, width, n_disparities = costs.shape
    for y in range(height):
        for x in range(width):
            for d in range(1, min(n_disparities, x + 1)):
                if costs[y, x, d] != costs[y, x, 0]:
                    return True
    return n_disparities == 1


@parallel_jit
def _distrust_constant_costs(costs, trusted):
    height, width, n_disparities = costs.shape
    for y in prange(height):
        for x in range(width):
            if not trusted[y, x]:
                continue
            row = costs[y, x, : min(n_disparities, x + 1)]
            low = np.int64(65536)
            high = np.int64(-1)
            for i in range(row.size):
                cost = np.int64(row[i])
                low = min(low, cost)
                high = max(high, cost)
            trusted[y, x] = high > low or n_disparities == 1
