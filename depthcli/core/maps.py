"""Result maps: values, and a status that explains every pixel without one."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntFlag
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Arrays by their type of number; docstrings give the shapes.
Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
Ints = NDArray[np.int32]
Mask = NDArray[np.bool_]
Image8 = NDArray[np.uint8]


class _Flags(IntFlag):
    @classmethod
    def _missing_(cls, value: object) -> Any:
        # enum does not accept integers of numpy.
        return cls(int(value)) if isinstance(value, np.integer) else super()._missing_(value)


class Status(_Flags):
    """Reason why a pixel has no value (NaN), or how its value was changed.

    ``OCCLUDED`` to ``NO_DATA`` are reasons why the matcher measured no reliable value. A filled pixel keeps its reason:
    ``OCCLUDED | FILLED``. Only steps of a method use ``SMOOTHED``: in results and files, 0 selects the measured pixels.
    """

    MEASURED = 0
    OCCLUDED = 1
    MISMATCH = 2
    OUT_OF_RANGE = 4
    NO_DATA = 8
    FILLED = 16
    SMOOTHED = 32


class DepthStatus(_Flags):
    """How a pixel of a sensor's depth map was changed; ``KEPT`` alone: measured and unchanged (or smoothed).

    At most one of the bits up to ``EMPTY`` is set; ``SAMPLED`` is additional information. Only steps of a method use
    ``SMOOTHED``; results and files do not have it.
    """

    KEPT = 0
    GAP_FILLED = 1  # unknown, filled by the model
    CORRECTED = 2  # measured, replaced by the model
    FALLBACK = 4  # the model gives no value either; filled from pixels around
    CARRIED = 8  # taken over from earlier frames
    EMPTY = 16  # no value
    SMOOTHED = 32
    SAMPLED = 64  # filled or replaced, and a second measurement of the same pixel (stereo) agrees


class VolumeStatus(_Flags):
    """Status of a voxel of a registration."""

    BOUNDED = 0
    OPEN_BOUND = 1


STATUS_HELP = {
    Status.MEASURED: "measured",
    Status.OCCLUDED: "occluded",
    Status.MISMATCH: "mismatch: the two views disagree, or the region was too small to be trusted",
    Status.OUT_OF_RANGE: "out of the search range",
    Status.NO_DATA: "no data",
    Status.FILLED: "filled: the value was put in from around; the reason's bit stays set",
}
"""Bit -> meaning for a pixel of a disparity map."""

DEPTH_STATUS_HELP = {
    DepthStatus.KEPT: "kept: the sensor's value, which may be smoothed",
    DepthStatus.GAP_FILLED: "gap filled: the sensor has no value here",
    DepthStatus.CORRECTED: "corrected: the sensor's value was judged wrong and replaced",
    DepthStatus.FALLBACK: "filled from around: the model has no value either",
    DepthStatus.CARRIED: "carried over from earlier frames",
    DepthStatus.EMPTY: "no value",
    DepthStatus.SAMPLED: "from stereo (transparent): filled or corrected, and stereo of the pixel itself gives the "
    "same value; without it the value is inferred from the pixels around",
}
"""Bit -> meaning for a pixel of a depth map."""

VOLUME_STATUS_HELP = {
    VolumeStatus.BOUNDED: "the bound of the error is finite",
    VolumeStatus.OPEN_BOUND: "open bound: the search ends before the error does; bound.* is +inf",
}
"""Bit -> meaning for a voxel of a registration."""


def without_smoothed(status: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return status bits without ``SMOOTHED``, which nearly every pixel of a result would have."""
    kept: NDArray[np.uint8] = status & ~np.uint8(Status.SMOOTHED)  # the same bit in both
    return kept


@dataclass(frozen=True)
class _Map:
    values: NDArray[np.float32]
    status: NDArray[np.uint8]

    def __post_init__(self) -> None:
        if self.values.ndim != 2 or self.values.shape != self.status.shape:
            raise ValueError(f"values {self.values.shape} and status {self.status.shape} must be the same (H, W)")
        if self.values.dtype != np.float32 or self.status.dtype != np.uint8:
            raise TypeError(f"expected float32 values and uint8 status, got {self.values.dtype}, {self.status.dtype}")

    @property
    def valid(self) -> NDArray[np.bool_]:
        """(H, W) bool: the pixel has a value."""
        return ~np.isnan(self.values)

    @property
    def density(self) -> float:
        """Share of pixels with a value, in [0, 1]."""
        return float(np.mean(self.valid))

    def _has(self, bits: int) -> NDArray[np.bool_]:
        has: NDArray[np.bool_] = (self.status & np.uint8(bits)) != 0
        return has


class MatchedMap(_Map):
    """Values that matching gave, with bits of :class:`Status`."""

    @property
    def measured(self) -> NDArray[np.bool_]:
        """(H, W) bool: the pixel has a value, and it was not filled in."""
        return self.valid & ~self._has(Status.FILLED)

    @property
    def filled(self) -> NDArray[np.bool_]:
        """(H, W) bool: the value was filled in, from pixels around."""
        return self._has(Status.FILLED)

    @property
    def occluded(self) -> NDArray[np.bool_]:
        """(H, W) bool: the right view does not see the pixel; it may have been filled."""
        return self._has(Status.OCCLUDED)

    @property
    def mismatched(self) -> NDArray[np.bool_]:
        """(H, W) bool: the views contradict each other about the pixel; it may have been filled."""
        return self._has(Status.MISMATCH)


class DisparityMap(MatchedMap):
    """Disparity of the left view: (H, W) float32, pixels, NaN = no value; status uint8, bits of :class:`Status`."""


class DepthMap(_Map):
    """Depth of the color camera's pixels: (H, W) float32, meters, NaN = no value; uint8, :class:`DepthStatus`."""

    @property
    def measured(self) -> NDArray[np.bool_]:
        """(H, W) bool: the value is the sensor's, or a second measurement's (``SAMPLED``)."""
        return self.valid & (self.kept | self._has(DepthStatus.SAMPLED))

    @property
    def kept(self) -> NDArray[np.bool_]:
        """(H, W) bool: the value is the sensor's, as it was or smoothed."""
        return ~self._has(_ADDED | DepthStatus.CORRECTED | DepthStatus.EMPTY)

    @property
    def filled(self) -> NDArray[np.bool_]:
        """(H, W) bool: the sensor has no value, and the pixel was filled."""
        return self._has(_ADDED)

    @property
    def corrected(self) -> NDArray[np.bool_]:
        """(H, W) bool: the sensor's value was replaced."""
        return self._has(DepthStatus.CORRECTED)


_ADDED = DepthStatus.GAP_FILLED | DepthStatus.FALLBACK | DepthStatus.CARRIED
