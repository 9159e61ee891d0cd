"""Result maps: values with a reason for every pixel that has none."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntFlag

import numpy as np
from numpy.typing import NDArray


class Status(IntFlag):
    """Why a pixel has no value (NaN), or what was done to the value it has.

    The first four say why the matcher found nothing trustworthy; ``FILLED`` and ``SMOOTHED`` are
    information about a value that is there. A filled pixel keeps its reason: ``OCCLUDED | FILLED``.
    """

    MEASURED = 0
    OCCLUDED = 1
    MISMATCH = 2
    OUT_OF_RANGE = 4
    NO_DATA = 8
    FILLED = 16
    SMOOTHED = 32


class DepthStatus(IntFlag):
    """What was done to a pixel of a sensor's depth map; ``KEPT`` alone was measured and left as it was (or smoothed).

    At most one of the bits up to ``EMPTY`` is set; ``SMOOTHED`` and ``SAMPLED`` are information beside it.
    """

    KEPT = 0
    GAP_FILLED = 1  # unknown, filled by the model
    CORRECTED = 2  # measured, replaced by the model
    FALLBACK = 4  # unknown to the model as well, filled from around
    CARRIED = 8  # taken over from earlier frames
    EMPTY = 16  # no value
    SMOOTHED = 32
    SAMPLED = 64  # filled or replaced, and a second measurement of this very pixel (stereo) says the same


@dataclass(frozen=True)
class _Map:
    values: NDArray[np.float32]
    status: NDArray[np.uint8]

    def __post_init__(self) -> None:
        if self.values.ndim != 2 or self.values.shape != self.status.shape:
            raise ValueError(f"values {self.values.shape} and status {self.status.shape} must be the same (H, W)")
        if self.values.dtype != np.float32 or self.status.dtype != np.uint8:
            raise TypeError(f"want float32 values and uint8 status, got {self.values.dtype}, {self.status.dtype}")

    @property
    def valid(self) -> NDArray[np.bool_]:
        """(H, W) bool: the pixel has a value."""
        return ~np.isnan(self.values)

    @property
    def density(self) -> float:
        """Share of pixels with a value, in [0, 1]."""
        return float(np.mean(self.valid))


class DisparityMap(_Map):
    """Disparity of the left view.

    Attributes
    ----------
    values : (H, W) float32, pixels, NaN = no value
    status : (H, W) uint8, bits of :class:`Status`
    """

    @property
    def measured(self) -> NDArray[np.bool_]:
        """(H, W) bool: the pixel has a value, and it was not filled in."""
        measured: NDArray[np.bool_] = self.valid & ((self.status & Status.FILLED) == 0)
        return measured


class DepthMap(_Map):
    """Depth of the color camera's pixels.

    Attributes
    ----------
    values : (H, W) float32, meters, NaN = no value
    status : (H, W) uint8, bits of :class:`DepthStatus`
    """
