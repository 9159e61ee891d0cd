"""Smoothing of volumes."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.kernels.jit import parallel_jit, prange


def gaussian(volume: NDArray[np.float32], sigma: float) -> NDArray[np.float32]:
    """Smooth by a Gaussian of ``sigma`` voxels, cut at 3 sigma, borders repeated; not along axes of one voxel."""
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
