"""Smoothing, shifting and resampling of volumes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.kernels.jit import parallel_jit, prange


def gaussian(volume: NDArray[np.float32], sigma: float) -> NDArray[np.float32]:
    """Gaussian of ``sigma`` voxels, cut at 3 sigma, borders repeated; axes of one voxel are left alone."""
    radius = int(np.ceil(3 * sigma))
    if radius == 0:
        return volume.copy()
    taps = np.exp(-0.5 * (np.arange(-radius, radius + 1) / sigma) ** 2)
    weights = (taps / taps.sum()).astype(np.float32)
    smooth = volume
    if volume.shape[0] > 1:
        padded = np.pad(smooth, ((radius, radius), (0, 0), (0, 0)), mode="edge")
        smooth = np.empty_like(volume)
        _along_first(padded, weights, smooth)
    planes = np.empty_like(volume)
    for z in range(volume.shape[0]):
        row = weights if volume.shape[2] > 1 else np.ones(1, np.float32)
        column = weights if volume.shape[1] > 1 else np.ones(1, np.float32)
        planes[z] = cv2.sepFilter2D(
            smooth[z], cv2.CV_32F, row, column, borderType=cv2.BORDER_REPLICATE
        ).reshape(planes[z].shape)  # fmt: skip
    return planes


@parallel_jit
def _along_first(padded: Any, weights: Any, out: Any) -> None:
    for z in prange(out.shape[0]):
        for y in range(out.shape[1]):
            row = out[z, y]
            row[:] = 0
            for k in range(weights.size):
                other = padded[z + k, y]
                w = weights[k]
                for i in range(row.size):
                    row[i] += w * other[i]


def shifted(volume: NDArray[Any], offset: Sequence[int]) -> NDArray[Any]:
    """``volume`` at x + offset, borders repeated."""
    for axis, step in enumerate(offset):
        if step:
            index = np.clip(np.arange(volume.shape[axis]) + step, 0, volume.shape[axis] - 1)
            volume = np.take(volume, index, axis=axis)
    return volume


def resample(
    volume: NDArray[np.float32], shape: tuple[int, int, int], step: Sequence[float], start: Sequence[float]
) -> NDArray[np.float32]:
    """Trilinear samples at ``start + step * i`` voxels along each axis, borders repeated.

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
