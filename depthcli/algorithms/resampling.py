"""Sampling of volumes: trilinear, nearest, block means, shifts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.maps import Doubles, Floats
from depthcli.kernels.jit import jit, run_bands


def trilinear(volume: Floats, coordinates: Doubles) -> Floats:
    """Return trilinear samples of a (Z, Y, X) volume at (N, 3) coordinates z, y, x in voxels, with repeated borders."""
    top = np.array(volume.shape) - 1
    inside = np.clip(coordinates, 0, top)
    low = np.minimum(inside.astype(np.int64), np.maximum(top - 1, 0))
    weight = inside - low
    total = np.zeros(len(coordinates))
    for corner in np.ndindex(2, 2, 2):
        at = np.minimum(low + corner, top)
        share = np.prod(np.where(np.array(corner) == 1, weight, 1 - weight), axis=1)
        total += share * volume[at[:, 0], at[:, 1], at[:, 2]]
    return total.astype(np.float32)


def nearest(volume: Floats, coordinates: Doubles) -> Floats:
    """Return the values of a (Z, Y, X) volume nearest to (N, 3) coordinates z, y, x in voxels; NaN outside."""
    index = np.rint(coordinates).astype(np.int64)
    inside = np.all((index >= 0) & (index < np.array(volume.shape)), axis=1)
    sampled = np.full(len(coordinates), np.nan, np.float32)
    sampled[inside] = volume[tuple(index[inside].T)]
    return sampled


def block_means(volume: NDArray[Any], block: tuple[int, int, int]) -> Floats:
    """Return the mean of every block of (z, y, x) voxels of a volume; the last block along an axis may be smaller."""
    if max(block) == 1:
        return volume.astype(np.float32, copy=False)
    starts = [np.arange(0, n, b) for n, b in zip(volume.shape, block, strict=True)]
    counts = [np.diff([*start, n]) for start, n in zip(starts, volume.shape, strict=True)]
    plane = counts[1][:, None] * counts[2][None, :]
    out = np.empty([len(start) for start in starts], np.float32)
    for k, first in enumerate(starts[0]):  # slice by slice, to avoid a second volume in memory
        total = volume[first : first + block[0]].sum(axis=0, dtype=np.float64)
        rows = np.add.reduceat(np.add.reduceat(total, starts[1], axis=0), starts[2], axis=1)
        out[k] = rows / (plane * counts[0][k])
    return out


def shifted(volume: NDArray[Any], offset: Sequence[int]) -> NDArray[Any]:
    """Return ``out[x] = volume[x + offset]`` along every axis, (z, y, x) voxels, borders repeated."""
    for axis, step in enumerate(offset):
        if step:
            index = np.clip(np.arange(volume.shape[axis]) + step, 0, volume.shape[axis] - 1)
            volume = np.take(volume, index, axis=axis)
    return volume


def resample(volume: Floats, shape: Sequence[int], step: Sequence[float], start: Sequence[float]) -> Floats:
    """Return trilinear samples of a (Z, Y, X) volume on a regular grid of ``shape``, borders repeated; float32.

    ``step`` and ``start`` are the distance of the samples and the position of the first one along z, y, x, in voxels.
    There is no anti-aliasing: if ``step`` is well above 1, smooth the volume first.
    """
    for axis in range(3):
        coordinates = start[axis] + step[axis] * np.arange(shape[axis], dtype=np.float64)
        coordinates = np.clip(coordinates, 0, volume.shape[axis] - 1)
        low = np.minimum(coordinates.astype(np.int64), max(volume.shape[axis] - 2, 0))
        high = np.minimum(low + 1, volume.shape[axis] - 1)
        weight = (coordinates - low).astype(np.float32).reshape([-1 if a == axis else 1 for a in range(3)])
        first = np.take(volume, low, axis=axis)
        volume = first + weight * (np.take(volume, high, axis=axis) - first)
    return np.ascontiguousarray(volume, np.float32)


def gaussian(volume: Floats, sigma: float) -> Floats:
    """Smooth with a Gaussian of ``sigma`` voxels, cut at 3 sigma, repeating borders; not along axes of one voxel."""
    radius = int(np.ceil(3 * sigma))
    if radius == 0:
        return volume.copy()
    taps = np.exp(-0.5 * (np.arange(-radius, radius + 1) / sigma) ** 2)
    weights = (taps / taps.sum()).astype(np.float32)
    smooth = volume
    if volume.shape[0] > 1:
        padded = np.pad(smooth, ((radius, radius), (0, 0), (0, 0)), mode="edge")
        smooth = np.empty_like(volume)
        run_bands(_along_first, len(smooth), padded, weights, smooth)
    planes = np.empty_like(volume)
    row, column = (weights if n > 1 else np.ones(1, np.float32) for n in volume.shape[:0:-1])
    for plane, source in zip(planes, smooth, strict=True):
        filtered = cv2.sepFilter2D(source, cv2.CV_32F, row, column, borderType=cv2.BORDER_REPLICATE)
        plane[:] = filtered.reshape(plane.shape)
    return planes


@jit
def _along_first(begin, end, padded, weights, out):
    for z in range(begin, end):
        for y in range(out.shape[1]):
            row = out[z, y]
            row[:] = 0
            for k in range(weights.size):
                other = padded[z + k, y]
                w = weights[k]
                for i in range(row.size):
                    row[i] += w * other[i]
