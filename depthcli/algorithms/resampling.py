"""Values of a volume between its voxels, at them, and of blocks of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray


def trilinear(values: NDArray[np.float32], places: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return trilinear values, (N,) float32, of a volume at (N, 3) places z, y, x in voxels, borders repeated."""
    top = np.array(values.shape) - 1
    place = np.clip(places, 0, top)
    low = np.minimum(place.astype(np.int64), np.maximum(top - 1, 0))
    weight = place - low
    total = np.zeros(len(places))
    for corner in np.ndindex(2, 2, 2):
        at = np.minimum(low + corner, top)
        share = np.prod(np.where(np.array(corner) == 1, weight, 1 - weight), axis=1)
        total += share * values[at[:, 0], at[:, 1], at[:, 2]]
    return total.astype(np.float32)


def nearest(values: NDArray[np.float32], places: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return the values, (N,) float32, of the voxels nearest to (N, 3) places z, y, x; NaN outside."""
    index = np.rint(places).astype(np.int64)
    inside = np.all((index >= 0) & (index < np.array(values.shape)), axis=1)
    sampled = np.full(len(places), np.nan, np.float32)
    sampled[inside] = values[tuple(index[inside].T)]
    return sampled


def block_means(values: NDArray[Any], blocks: tuple[int, int, int]) -> NDArray[np.float32]:
    """Return the means, float32, of ``blocks`` (z, y, x) of voxels, of smaller ones at the far borders."""
    if max(blocks) == 1:
        return values.astype(np.float32, copy=False)
    starts = [np.arange(0, n, b) for n, b in zip(values.shape, blocks, strict=True)]
    counts = [np.diff([*start, n]) for start, n in zip(starts, values.shape, strict=True)]
    plane = counts[1][:, None] * counts[2][None, :]
    out = np.empty([len(start) for start in starts], np.float32)
    for k, first in enumerate(starts[0]):  # slice by slice: no second volume is in memory
        total = values[first : first + blocks[0]].sum(axis=0, dtype=np.float64)
        rows = np.add.reduceat(np.add.reduceat(total, starts[1], axis=0), starts[2], axis=1)
        out[k] = rows / (plane * counts[0][k])
    return out


def shifted(volume: NDArray[Any], offset: Sequence[int]) -> NDArray[Any]:
    """Return ``volume`` at x + offset, borders repeated."""
    for axis, step in enumerate(offset):
        if step:
            index = np.clip(np.arange(volume.shape[axis]) + step, 0, volume.shape[axis] - 1)
            volume = np.take(volume, index, axis=axis)
    return volume


def resample(
    volume: NDArray[np.float32], shape: tuple[int, int, int], step: Sequence[float], start: Sequence[float]
) -> NDArray[np.float32]:
    """Return trilinear samples at ``start + step * i`` voxels along each axis, borders repeated.

    Axis by axis; no anti-aliasing: smooth first where ``step`` is well above 1.
    """
    for axis in range(3):
        place = start[axis] + step[axis] * np.arange(shape[axis], dtype=np.float64)
        place = np.clip(place, 0, volume.shape[axis] - 1)
        low = np.minimum(place.astype(np.int64), max(volume.shape[axis] - 2, 0))
        high = np.minimum(low + 1, volume.shape[axis] - 1)
        weight = (place - low).astype(np.float32).reshape([-1 if a == axis else 1 for a in range(3)])
        first = np.take(volume, low, axis=axis)
        volume = first + weight * (np.take(volume, high, axis=axis) - first)
    return np.ascontiguousarray(volume, np.float32)
