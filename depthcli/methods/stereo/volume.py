"""The types that the stages of a stereo pipeline pass to each other: cost volumes, data for refinement, the result.

Aggregated costs are fixed-point means: uint16 with four more fractional bits than uint8 costs. So a mean never exceeds
255 * 16 = 4080, and eight path costs of a scanline optimizer fit into 16 bits.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from depthcli.core import memory
from depthcli.core.frames import StereoPair
from depthcli.core.maps import DisparityMap, Floats
from depthcli.core.result import Result
from depthcli.kernels.jit import jit, run_bands
from depthcli.kernels.winners import winners


@dataclass(frozen=True)
class CostVolume:
    """Matching costs of every pixel and disparity; lower is better.

    ``costs`` is (H, W, D), C-contiguous, uint8, uint16 or float32; ``costs[y, x, d]`` compares left (y, x) with right
    (y, x - d). Every cell is finite. Cells with d > x are outside the right image: they have a neutral cost, and are
    skipped when disparities are selected or counted. ``costs / scale`` is the measure's cost.
    """

    costs: NDArray[Any]
    scale: float = 1.0

    def __post_init__(self) -> None:
        if self.costs.ndim != 3 or not self.costs.flags.c_contiguous:
            raise ValueError("costs must be C-contiguous (H, W, D)")
        if self.costs.dtype not in (np.uint8, np.uint16, np.float32):
            raise TypeError(f"costs must be uint8, uint16 or float32, got {self.costs.dtype}")

    @property
    def n_disparities(self) -> int:
        """Return D, the number of disparities searched: 0 .. D - 1."""
        return int(self.costs.shape[2])


@dataclass(frozen=True)
class CostMinima:
    """The cheapest cells of a volume. If a pair was matched in tiles, nothing else is kept.

    ``minima`` are the minima of the parabolas through the cheapest cells and the ones next to them, or the disparity
    itself if it is no local minimum.
    """

    left: NDArray[np.uint16]  # (H, W), disparities of the cheapest cells
    minima: Floats
    n_disparities: int

    @classmethod
    def of(cls, volume: CostVolume) -> tuple[CostMinima, NDArray[np.uint16]]:
        """Return the cheapest cells of a volume, and the (H, W) disparities of the right view's cheapest cells."""
        minima = np.empty(volume.costs.shape[:2], np.float32)
        left, right = winners(volume.costs, minima)
        return cls(left, minima, volume.n_disparities), right


@dataclass(frozen=True)
class RefinementContext:
    """Data for refinement steps besides the map that they refine.

    ``volume`` is the one whose cheapest cells are in the map; steps without ``needs_costs`` may only get its minima.
    """

    pair: StereoPair
    volume: CostVolume | CostMinima
    right: NDArray[Any]  # (H, W) uint16 or float32 disparities of the right view, read along the volume's diagonals
    known: CostMinima | None = None

    @property
    def minima(self) -> CostMinima:
        """The cheapest cells of the volume; computed if ``known`` does not give them."""
        if isinstance(self.volume, CostMinima):
            return self.volume
        return CostMinima.of(self.volume)[0] if self.known is None else self.known


@dataclass
class StereoResult(Result):
    """The result of a stereo pipeline: the left view's map."""

    disparity: DisparityMap


class FixedPoint:
    """The format of aggregated costs: stored units per unit of a uint8 cost, and the largest stored cost."""

    FRACTION: ClassVar[int] = 16
    LARGEST: ClassVar[int] = 255 * 16


def as_fixed_point(volume: CostVolume) -> CostVolume:
    """Return the volume as uint16 fixed point, at most ``FixedPoint.LARGEST``; a float32 volume is scaled to fit."""
    costs = volume.costs
    if costs.dtype == np.uint16:
        return volume
    if costs.dtype == np.uint8:
        factor = float(FixedPoint.FRACTION)
    else:
        low, high = float(costs.min()), float(costs.max())
        if low < 0:
            costs, high = costs - np.float32(low), high - low
        factor = FixedPoint.LARGEST / high if high > 0 else 1.0
    fixed: NDArray[np.uint16] = memory.empty(costs.shape, np.uint16)
    rows = costs.shape[0]
    run_bands(_scale, rows, costs.reshape(rows, -1), np.float32(factor), fixed.reshape(rows, -1))
    return CostVolume(fixed, volume.scale * factor)


@jit
def _scale(begin, end, costs, factor, fixed):
    half = np.float32(0.5)
    for y in range(begin, end):
        source, out = costs[y], fixed[y]
        for i in range(out.size):
            out[i] = np.uint16(np.int32(np.float32(source[i]) * factor + half))


def fill_outside(costs: NDArray[Any], outside: np.generic) -> None:
    """Set the cells of (H, W, D) costs whose match is outside the right image, d > x."""
    run_bands(_fill_outside, len(costs), costs, outside)


@jit
def _fill_outside(begin, end, costs, outside):
    _, width, n_disparities = costs.shape
    for y in range(begin, end):
        for x in range(min(width, n_disparities - 1)):
            for d in range(x + 1, n_disparities):
                costs[y, x, d] = outside
