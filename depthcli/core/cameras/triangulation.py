"""Disparity and depth of a rectified pair: the formulas of triangulation."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.core.cameras.camera import Intrinsics, off_center
from depthcli.core.errors import InputError

_ROUNDING = 0.01  # relative difference of two factors of size that rounding to whole pixels explains


def depth_of_disparity(disparity: NDArray[np.floating[Any]], fb: float, offset: float = 0.0) -> NDArray[np.float32]:
    """Return the depth ``fb / (d + offset)`` of a rectified pair; float32, meters.

    ``fb`` is focal length x baseline, pixel meters, ``offset`` the difference of the principal points (``doffs`` of
    Middlebury v3), pixels. NaN where the disparity is unknown or the point is not in front of the cameras.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = (fb / (disparity.astype(np.float64) + offset)).astype(np.float32)
    depth[~(np.isfinite(depth) & (depth > 0))] = np.nan
    return depth


def disparity_of_depth(depth: NDArray[np.floating[Any]], fb: float, offset: float = 0.0) -> NDArray[np.float32]:
    """Return the inverse of :func:`depth_of_disparity`; float32, pixels, NaN where the depth is not positive."""
    with np.errstate(divide="ignore", invalid="ignore"):
        disparity = (fb / depth.astype(np.float64) - offset).astype(np.float32)
    disparity[~(np.isfinite(disparity) & (depth > 0))] = np.nan
    return disparity


@dataclass(frozen=True)
class PairGeometry:
    """The left camera of a rectified pair and the position of the right one.

    Raise InputError if numbers are not finite, or the focal lengths or the baseline are not positive.
    """

    left: Intrinsics
    baseline: float  # meters
    offset: float = 0.0  # right minus left principal point along x (Middlebury's doffs), pixels
    size: tuple[int, int] | None = None  # (width, height) of the images that these numbers are for, if known

    def __post_init__(self) -> None:
        numbers = (self.left.fx, self.left.fy, self.left.cx, self.left.cy, self.baseline, self.offset)
        if not np.isfinite(numbers).all():
            raise InputError("calibration: expected finite numbers")
        if self.left.fx <= 0 or self.left.fy <= 0:
            raise InputError(f"calibration: a focal length of {min(self.left.fx, self.left.fy):g} pixels")
        if self.baseline <= 0:
            raise InputError(f"calibration: a baseline of {self.baseline:g} m; are left and right exchanged?")

    @property
    def fb(self) -> float:
        """Focal length x baseline, pixel meters."""
        return self.left.fx * self.baseline

    def depth(self, disparity: NDArray[np.floating[Any]]) -> NDArray[np.float32]:
        """Return ``Z = f b / (d + offset)``; float32, meters, NaN where unknown or not in front of the cameras."""
        return depth_of_disparity(disparity, self.fb, self.offset)

    def depth_bound(
        self, disparity: NDArray[np.floating[Any]], bound: NDArray[np.floating[Any]]
    ) -> NDArray[np.float32]:
        """Return the error of the depth if the disparity is off by ``bound`` pixels, float32, meters.

        It is the larger distance, behind the surface. It is infinite if the disparity may be 0, and NaN if depth or
        bound is unknown.
        """
        smallest = disparity - bound
        behind = self.depth(smallest) - self.depth(disparity)
        return np.where(smallest + np.float32(self.offset) > 0, behind, disparity * np.float32(0) + np.float32(np.inf))

    def doubts(self, width: int, height: int) -> str:
        """Return why numbers without an image size probably do not fit this one, or an empty text."""
        return off_center(self.left, (width, height)) if self.size is None else ""

    def for_size(self, width: int, height: int) -> PairGeometry:
        """Return the cameras for images of another size. Raise InputError if their aspect ratio differs."""
        if self.size is None or self.size == (width, height):
            return replace(self, size=(width, height))
        across, down = width / self.size[0], height / self.size[1]
        if abs(across - down) > _ROUNDING * max(across, down) + 1 / min(*self.size, width, height):
            raise InputError(f"calibrated for {self.size[0]} x {self.size[1]} pixels, the map has {width} x {height}")
        left = self.left
        # The center of the first pixel is (0, 0); its corner stays when the size changes.
        center = ((left.cx + 0.5) * across - 0.5, (left.cy + 0.5) * down - 0.5)
        scaled = Intrinsics(left.fx * across, left.fy * down, *center)
        return PairGeometry(scaled, self.baseline, self.offset * across, (width, height))
