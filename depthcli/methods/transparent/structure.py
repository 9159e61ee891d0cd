"""What a cost volume says where an image has structure, and nothing where it has none."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.filters import local_moments
from depthcli.core import memory
from depthcli.kernels.jit import parallel_jit, prange
from depthcli.methods.stereo.volume import CostVolume


def deviation(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    """(H, W) float32: standard deviation of grey levels in 9 x 9."""
    return np.asarray(np.sqrt(local_moments(image.astype(np.float32), 9)[1]), np.float32)


def quieted(volume: CostVolume, left: NDArray[np.uint8], right: NDArray[np.uint8], structure: float) -> CostVolume:
    """Costs drawn towards the pixel's mean cost as far as one of the two windows lacks structure.

    Order, rank and correlation of a flat window are those of its noise, and a saturated one is like any other flat
    one: such costs would outvote the few pixels at the outlines that know better.

    Parameters
    ----------
    volume : (H, W, D) uint8 or uint16
    left, right : (H, W) uint8
    structure : standard deviation in 9 x 9 from which costs count in full, grey levels, > 0

    Returns
    -------
    CostVolume
        Of the same scale, uint16.
    """
    shares = [np.minimum(deviation(image) / np.float32(structure), np.float32(1)) for image in (left, right)]
    out: NDArray[np.uint16] = memory.empty(volume.costs.shape, np.uint16)
    _quiet(volume.costs, shares[0], shares[1], out)
    return CostVolume(out, volume.scale)


def cost_at(volume: CostVolume, disparity: NDArray[np.float32]) -> NDArray[np.float32]:
    """(H, W) float32, in units of the measure: the lower of the costs beside a disparity, NaN where that is unknown.

    Parameters
    ----------
    disparity : (H, W) float32, pixels; beyond the range its end counts
    """
    top = np.float32(volume.disparities - 1)
    low = np.floor(np.clip(np.nan_to_num(disparity), 0, top)).astype(np.int64)
    rows, columns = np.ogrid[: low.shape[0], : low.shape[1]]
    beside = [volume.costs[rows, columns, np.minimum(low + step, volume.disparities - 1)] for step in (0, 1)]
    costs = np.minimum(*beside).astype(np.float32) / np.float32(volume.scale)
    return np.where(np.isfinite(disparity), costs, np.float32(np.nan))


def mean_cost(volume: CostVolume) -> NDArray[np.float32]:
    """(H, W) float32, in units of the measure: what a pixel's disparities cost in the mean."""
    return np.asarray(volume.costs.mean(axis=2, dtype=np.float32) / np.float32(volume.scale), np.float32)


@parallel_jit
def _quiet(costs: Any, left: Any, right: Any, out: Any) -> None:
    height, width, depth = costs.shape
    half = np.float32(0.5)
    for y in prange(height):
        # Mirrored, so that a pixel's right shares run the way its disparities do; outside the image none counts less.
        mirror = np.ones(width + depth, np.float32)
        for x in range(width):
            mirror[width - 1 - x] = right[y, x]
        for x in range(width):
            source, target = costs[y, x], out[y, x]
            shares = mirror[width - 1 - x : width - 1 - x + depth]
            total = np.uint32(0)
            for i in range(source.size):
                total += np.uint32(source[i])
            mean = np.float32(total) / np.float32(source.size)
            own = left[y, x]
            for i in range(source.size):
                share = min(own, shares[i])
                target[i] = np.uint16(np.int32(mean + share * (np.float32(source[i]) - mean) + half))
