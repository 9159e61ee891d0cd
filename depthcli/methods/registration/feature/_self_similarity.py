"""Descriptors of self-similarity: exponentials of patch distances, 0 .. MAX_SMALL_VALUE."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.resampling import shifted
from depthcli.kernels.exponential import exp_minus
from depthcli.kernels.jit import parallel_jit, prange
from depthcli.methods.registration.search import MAX_SMALL_VALUE
from depthcli.methods.registration.smoothing import gaussian

_STEPS = ((0, 0, 1), (0, 0, -1), (0, 1, 0), (0, -1, 0), (1, 0, 0), (-1, 0, 0))


def steps(shape: tuple[int, ...], distance: int) -> list[tuple[int, ...]]:
    """Return the neighbors at ``distance`` along the axes; none along an axis of one voxel."""
    return [tuple(distance * s for s in step) for step in _STEPS if shape[next(a for a in range(3) if step[a])] > 1]


def descriptor(
    volume: NDArray[np.float32], pairs: Sequence[tuple[tuple[int, ...], tuple[int, ...]]], sigma: float
) -> NDArray[np.uint8]:
    """Compute exp(-(D_r - min D) / V) of the patch distance D_r of every pair of places; (C, Z, Y, X) uint8.

    Without any pair, in a volume of one voxel, one channel without content.
    """
    distances = np.zeros((max(1, len(pairs)), *volume.shape), np.float32)
    for r, (one, other) in enumerate(pairs):
        difference = shifted(volume, one) - shifted(volume, other)
        distances[r] = gaussian(difference * difference, sigma)
    variance = distances.mean(axis=0)
    mean = float(variance.mean(dtype=np.float64)) or 1.0
    np.clip(variance, 1e-3 * mean, 1e3 * mean, out=variance)
    out = np.empty(distances.shape, np.uint8)
    _exponentials(distances, variance, out)
    return out


@parallel_jit
def _exponentials(distances: Any, variance: Any, out: Any) -> None:
    channels, depth, height, width = distances.shape
    for z in prange(depth):
        lowest = np.empty(width, np.float32)
        for y in range(height):
            lowest[:] = distances[0, z, y]
            for c in range(1, channels):
                row = distances[c, z, y]
                for i in range(width):
                    lowest[i] = min(lowest[i], row[i])
            scale = variance[z, y]
            for c in range(channels):
                row, target = distances[c, z, y], out[c, z, y]
                for i in range(width):
                    value = exp_minus((row[i] - lowest[i]) / scale[i])
                    target[i] = np.uint8(np.int32(value * np.float32(MAX_SMALL_VALUE) + np.float32(0.5)))
