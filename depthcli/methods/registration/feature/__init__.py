"""Features for the comparison of voxels. One file per feature."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.resampling import gaussian, shifted
from depthcli.core.method import Method, method_of
from depthcli.kernels.exponential import exp_minus
from depthcli.kernels.jit import empty, jit, run_bands
from depthcli.methods.registration._search_kernels import MAX_SMALL_VALUE

VolumeArray = NDArray[np.float32]
"""(Z, Y, X), finite, with cubic voxels."""
Channels = NDArray[np.uint8]
"""(C, Z, Y, X)."""
Place = tuple[int, ...]
"""(z, y, x), relative to a voxel."""
_MIN_RANGE = 1e-35  # smaller ranges count as none: float32 cannot represent 255 levels over them
_STEPS = ((0, 0, 1), (0, 0, -1), (0, 1, 0), (0, -1, 0), (1, 0, 0), (-1, 0, 0))


class VolumeFeature(Method):
    """Converts two volumes to channels of integers, so that sums of differences are exact."""

    channels: ClassVar[int]
    """Largest number of channels, for memory estimates."""

    @abstractmethod
    def __call__(self, fixed: VolumeArray, warped: VolumeArray) -> tuple[Channels, Channels]:
        """Compute the channels of both volumes on a common scale; the inputs are not modified."""


Feature = Annotated[VolumeFeature, *method_of("depthcli.methods.registration.feature")]


def levels(
    fixed: NDArray[np.float32], warped: NDArray[np.float32], outliers: float
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Map both arrays to 0 .. 255, from their common range without ``outliers`` percent at either end."""
    both = np.concatenate([fixed.ravel(), warped.ravel()])
    low, high = (float(v) for v in np.percentile(both, [outliers, 100 - outliers]))
    if high - low < _MIN_RANGE:
        low, high = float(both.min()), float(both.max())
    scale = np.float32(255 / (high - low) if high - low >= _MIN_RANGE else 0)
    one, other = (
        np.rint((np.clip(values, np.float32(low), np.float32(high)) - np.float32(low)) * scale).clip(0, 255)
        for values in (fixed, warped)
    )
    return one.astype(np.uint8), other.astype(np.uint8)


def steps(shape: tuple[int, ...], distance: int) -> list[Place]:
    """Return the offsets of the neighbors at ``distance`` along the axes; none along an axis of one voxel."""
    return [tuple(distance * s for s in step) for step in _STEPS if shape[next(a for a in range(3) if step[a])] > 1]


def descriptor(volume: NDArray[np.float32], pairs: Sequence[tuple[Place, Place]], sigma: float) -> NDArray[np.uint8]:
    """Compute exp(-(D_r - min D) / V) from the patch distance D_r of every pair of places; (C, Z, Y, X) uint8.

    If there is no pair (a volume of one voxel), return one constant channel.
    """
    distances = np.zeros((max(1, len(pairs)), *volume.shape), np.float32)
    for r, (one, other) in enumerate(pairs):
        difference = shifted(volume, one) - shifted(volume, other)
        distances[r] = gaussian(difference * difference, sigma)
    variance = distances.mean(axis=0)
    mean = float(variance.mean(dtype=np.float64)) or 1.0
    np.clip(variance, 1e-3 * mean, 1e3 * mean, out=variance)
    out = np.empty(distances.shape, np.uint8)
    run_bands(_exponentials, distances.shape[1], distances, variance, out)
    return out


@jit
def _exponentials(begin, end, distances, variance, out):
    channels, _, height, width = distances.shape
    for z in range(begin, end):
        lowest = empty(width, np.float32)
        for y in range(height):
            for i in range(width):
                lowest[i] = distances[0, z, y, i]
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
