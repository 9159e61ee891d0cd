"""Inputs of registration confidence: two volumes on one grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class RegisteredPair:
    """A fixed volume and the moving one after registration, sampled on the fixed grid.

    Attributes
    ----------
    fixed, warped : (Z, Y, X) float32, same shape, finite; a 2-D image has Z = 1
    spacing : (z, y, x) distance of neighboring voxels, mm
    mask : (Z, Y, X) bool, True = of interest, or None for all
    """

    fixed: NDArray[np.float32]
    warped: NDArray[np.float32]
    spacing: tuple[float, float, float]
    mask: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        if self.fixed.ndim != 3 or self.fixed.shape != self.warped.shape:
            raise ValueError(f"want two (Z, Y, X) volumes of one shape, got {self.fixed.shape}, {self.warped.shape}")
        if self.fixed.dtype != np.float32 or self.warped.dtype != np.float32:
            raise TypeError(f"want float32 volumes, got {self.fixed.dtype}, {self.warped.dtype}")
        if self.mask is not None and (self.mask.shape != self.fixed.shape or self.mask.dtype != np.bool_):
            raise ValueError(f"want a bool mask of shape {self.fixed.shape}, got {self.mask.shape} {self.mask.dtype}")
        if len(self.spacing) != 3 or not all(np.isfinite(s) and s > 0 for s in self.spacing):
            raise ValueError(f"want three positive spacings, got {self.spacing}")
        if not (np.isfinite(self.fixed).all() and np.isfinite(self.warped).all()):
            raise ValueError("the volumes must be finite")

    @property
    def shape(self) -> tuple[int, int, int]:
        """(Z, Y, X)."""
        z, y, x = self.fixed.shape
        return z, y, x
