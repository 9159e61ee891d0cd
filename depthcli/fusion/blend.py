"""Costs of several measures on one scale, and their weighted mean."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import prange
from numpy.typing import NDArray

from depthcli.core import memory
from depthcli.kernels._jit import jit, parallel_jit
from depthcli.kernels.exponential import exp_minus
from depthcli.stereo.volume import CostVolume

UNIT = 255
"""Stored value of the cost 1."""


def squash(volume: CostVolume, scale: float | None) -> CostVolume:
    """Costs of any measure brought to [0, 1]: ``1 - exp(-C / scale)`` (the form of Mei et al. 2011).

    Parameters
    ----------
    volume : (H, W, D); costs below zero are shifted up to zero
    scale : cost that becomes 1 - 1/e, in units of the measure; None: the median cost, so that every
        measure has half of its costs above 1 - 1/e

    Returns
    -------
    CostVolume
        uint8, ``scale`` 255; cells outside the right image hold the mean of the others.
    """
    costs = volume.costs
    offset = min(0.0, float(costs.min())) if costs.dtype == np.float32 else 0.0
    middle = typical_cost(costs) - offset if scale is None else scale * volume.scale
    out: NDArray[np.uint8] = memory.empty(costs.shape, np.uint8)
    sums = np.zeros(costs.shape[0], np.int64)
    _squash(costs, np.float32(offset), np.float32(1.0 / middle if middle > 0 else 1.0), out, sums)
    height, width, depth = costs.shape
    inside = height * int(np.minimum(np.arange(1, width + 1), depth).sum())
    _fill_outside(out, np.uint8(round(int(sums.sum()) / inside)))
    return CostVolume(out, float(UNIT))


def typical_cost(costs: NDArray[Any]) -> float:
    """Median of the cells inside the right image, over every fourth row."""
    if costs.dtype == np.float32:
        width, depth = costs.shape[1:]
        inside = np.arange(depth)[None, :] <= np.arange(width)[:, None]
        return float(np.median(costs[::4][:, inside]))
    counts = np.zeros(256 if costs.dtype == np.uint8 else 65536, np.int64)
    _histogram(costs, counts)
    total = np.cumsum(counts)
    return float(np.searchsorted(total, (total[-1] + 1) // 2))


def blend(volumes: list[CostVolume], weights: NDArray[np.float32]) -> CostVolume:
    """Weighted mean of volumes of one scale.

    Parameters
    ----------
    volumes : M uint8 (H, W, D) volumes
    weights : (M, H, W) float32, summing to 1 over M

    Returns
    -------
    CostVolume
        uint8, of the same scale. Weights are rounded to 1/256, the largest one takes what is left over.
    """
    fixed = np.round(weights * 256).astype(np.int32)
    largest = np.argmax(fixed, axis=0)[None]
    rest = 256 - fixed.sum(axis=0, keepdims=True)
    np.put_along_axis(fixed, largest, np.take_along_axis(fixed, largest, 0) + rest, 0)
    total: NDArray[np.uint16] = memory.empty(volumes[0].costs.shape, np.uint16)
    for m, volume in enumerate(volumes):
        _accumulate(volume.costs, fixed[m].astype(np.uint16), total, m == 0)
    out: NDArray[np.uint8] = memory.empty(total.shape, np.uint8)
    _shorten(total, out)
    return CostVolume(out, volumes[0].scale)


def add_weighted(total: NDArray[np.float32], volume: CostVolume, weights: NDArray[np.float32]) -> None:
    """Add ``weights`` (H, W) times the volume's costs, in units of the measure, to float32 ``total``."""
    _add_weighted(volume.costs, weights * np.float32(1.0 / volume.scale), total)


@jit
def _histogram(costs: Any, counts: Any) -> None:
    height, width, depth = costs.shape
    for y in range(0, height, 4):
        for x in range(width):
            for d in range(min(depth, x + 1)):
                counts[costs[y, x, d]] += 1


@parallel_jit
def _squash(costs: Any, offset: Any, rate: Any, out: Any, sums: Any) -> None:
    height, width, depth = costs.shape
    unit, one, half = np.float32(255.0), np.float32(1.0), np.float32(0.5)
    for y in prange(height):
        total = np.int64(0)
        for x in range(width):
            source = costs[y, x]
            cells = out[y, x]
            for i in range(cells.size):
                cells[i] = np.uint8(np.int32(unit * (one - exp_minus((np.float32(source[i]) - offset) * rate)) + half))
            inside = out[y, x, : min(depth, x + 1)]
            part = np.int32(0)
            for i in range(inside.size):
                part += np.int32(inside[i])
            total += part
        sums[y] = total


@parallel_jit
def _fill_outside(costs: Any, value: Any) -> None:
    height, width, depth = costs.shape
    for y in prange(height):
        for x in range(min(width, depth - 1)):
            for d in range(x + 1, depth):
                costs[y, x, d] = value


@parallel_jit
def _accumulate(costs: Any, weights: Any, total: Any, first: bool) -> None:
    height, width, _ = costs.shape
    for y in prange(height):
        for x in range(width):
            w = weights[y, x]
            source = costs[y, x]
            cells = total[y, x]
            if first:
                for i in range(cells.size):
                    cells[i] = np.uint16(np.uint16(source[i]) * w)
            else:
                for i in range(cells.size):
                    cells[i] = np.uint16(cells[i] + np.uint16(np.uint16(source[i]) * w))


@parallel_jit
def _shorten(total: Any, out: Any) -> None:
    height, width, depth = total.shape
    for y in prange(height):
        source = total[y].reshape(width * depth)
        cells = out[y].reshape(width * depth)
        for i in range(cells.size):
            cells[i] = np.uint8((source[i] + np.uint16(128)) >> np.uint16(8))


@parallel_jit
def _add_weighted(costs: Any, weights: Any, total: Any) -> None:
    height, width, _ = costs.shape
    for y in prange(height):
        for x in range(width):
            w = weights[y, x]
            source = costs[y, x]
            cells = total[y, x]
            for i in range(cells.size):
                cells[i] += w * np.float32(source[i])
