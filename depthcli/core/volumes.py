"""Volumes on their grids, and registered pairs, the input of registration confidence."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

ScalarT = TypeVar("ScalarT", bound=np.generic)

PLANES = ("axial", "coronal", "sagittal")
"""Anatomical planes of the slices across axes 0, 1 and 2 of an array that :meth:`Grid.turned` returns."""
ENDS = ("SI", "AP", "RL")
"""Sides of the first and of the last voxel along these axes; positions are positive towards S, A and R."""


@dataclass(frozen=True)
class Grid:
    """Positions of a volume's voxels, mm, in ITK's LPS frame."""

    size: tuple[int, int, int]  # voxels along x, y, z
    spacing: tuple[float, float, float]  # distance of voxels along the volume's own axes, mm
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)  # position of the first voxel
    direction: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)  # (3, 3), columns are the axes

    @property
    def shape(self) -> tuple[int, int, int]:
        """(Z, Y, X)."""
        return self.size[2], self.size[1], self.size[0]

    @property
    def axes(self) -> NDArray[np.float64]:
        """(3, 3): columns are the directions of the axes x, y, z."""
        return np.array(self.direction).reshape(3, 3)

    def to_index(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the array coordinates (N, 3) z, y, x, voxels, of positions (N, 3) x, y, z, mm."""
        own = (points - np.array(self.origin)) @ np.linalg.inv(self.axes).T
        coordinates: NDArray[np.float64] = (own / np.array(self.spacing))[:, ::-1]
        return coordinates

    def to_point(self, coordinates: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the positions (N, 3) x, y, z, mm, of array coordinates (N, 3) z, y, x, voxels."""
        along_axes = coordinates[:, ::-1] * np.array(self.spacing)
        points: NDArray[np.float64] = along_axes @ self.axes.T + np.array(self.origin)
        return points

    def anatomical_axes(self) -> tuple[tuple[int, int, int], tuple[int, ...]]:
        """Return how an array on this grid is turned so that its slices appear as radiologists display them.

        Return the order of its axes (nearest to superior-inferior, anterior-posterior and right-left), and the
        positions in that order of the axes to flip.
        """
        # Row a: how far the array's axis a (z, y, x) runs towards inferior, posterior and left of the LPS frame.
        along = self.axes.T[::-1] @ np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]])
        a, b, c = max(permutations(range(3)), key=lambda axes: sum(abs(along[n, k]) for k, n in enumerate(axes)))
        return (a, b, c), tuple(k for k, n in enumerate((a, b, c)) if along[n, k] < 0)

    def turned(self, values: NDArray[ScalarT]) -> NDArray[ScalarT]:
        """Return a (Z, Y, X) array with axes from superior to inferior, anterior to posterior and right to left."""
        order, flipped = self.anatomical_axes()
        return np.flip(values.transpose(order), flipped)

    def slice_positions(self, axis: int) -> tuple[float, float]:
        """Return the position of the first slice across ``axis`` of a turned array and the step to the next one, mm.

        Positive towards superior, anterior and right for the axes 0, 1 and 2. Positions are the centers of the
        slices: on an oblique grid, other points of a slice have other positions.
        """
        order, flipped = self.anatomical_axes()
        ends = np.tile((np.array(self.shape) - 1) / 2, (2, 1))
        ends[:, order[axis]] = (1, 0) if axis in flipped else (0, 1)
        if axis in flipped:
            ends[:, order[axis]] += self.shape[order[axis]] - 2
        first, second = self.to_point(ends)[:, 2 - axis] * (1 if axis == 0 else -1)
        return float(first), float(second - first)

    def same_as(self, other: Grid) -> bool:
        """Return whether voxels have the same positions, up to a hundredth of the smallest spacing."""
        if self.size != other.size:
            return False
        tolerance = 0.01 * min(self.spacing)
        corners = np.vstack([np.zeros(3), np.diag(np.array(self.shape) - 1.0)])
        return bool(np.allclose(self.to_point(corners), other.to_point(corners), atol=tolerance, rtol=0))

    def describe_difference(self, other: Grid) -> str:
        """Return the first property that differs by 1e-3, as ``size 3 x 4 x 1, expected 5 x 6 x 1``, for messages."""
        for name in ("size", "spacing", "origin", "direction"):
            own, others = getattr(self, name), getattr(other, name)
            if name == "direction" or not np.allclose(own, others, rtol=1e-3, atol=1e-3):
                break
        between = " x " if name == "size" else " "
        have, expected = (between.join(f"{number:.6g}" for number in numbers) for numbers in (own, others))
        return f"{name} {have}, expected {expected}"


@dataclass(frozen=True)
class Volume:
    """Values on a grid: (Z, Y, X) float32, or (Z, Y, X, 3) float32 of a vector field."""

    values: NDArray[np.float32]
    grid: Grid


@dataclass(frozen=True)
class RegisteredPair:
    """A fixed volume and the moving one after registration, sampled on the fixed grid; a 2-D image has Z = 1."""

    fixed: NDArray[np.float32]  # (Z, Y, X), finite
    warped: NDArray[np.float32]
    spacing: tuple[float, float, float]  # (z, y, x) distance of neighboring voxels, mm
    mask: NDArray[np.bool_] | None = None  # (Z, Y, X), True = of interest; None: all
    grid: Grid | None = None  # where the voxels are, if that is known

    def __post_init__(self) -> None:
        if self.fixed.ndim != 3 or self.fixed.shape != self.warped.shape:
            raise ValueError(f"expected two (Z, Y, X) of one shape, got {self.fixed.shape}, {self.warped.shape}")
        if self.fixed.dtype != np.float32 or self.warped.dtype != np.float32:
            raise TypeError(f"expected float32 volumes, got {self.fixed.dtype}, {self.warped.dtype}")
        if self.mask is not None and (self.mask.shape != self.fixed.shape or self.mask.dtype != np.bool_):
            raise ValueError(f"expected a bool mask {self.fixed.shape}, got {self.mask.shape} {self.mask.dtype}")
        if len(self.spacing) != 3 or not all(np.isfinite(s) and s > 0 for s in self.spacing):
            raise ValueError(f"expected three positive spacings, got {self.spacing}")
        if not (np.isfinite(self.fixed).all() and np.isfinite(self.warped).all()):
            raise ValueError("the volumes must be finite")

    @property
    def shape(self) -> tuple[int, int, int]:
        """(Z, Y, X)."""
        z, y, x = self.fixed.shape
        return z, y, x
