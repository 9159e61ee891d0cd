"""Search ranges from matched key points: which disparities a segment is likely to have."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.core import memory
from depthcli.kernels.jit import parallel_jit, prange
from depthcli.methods.stereo.keypoint_matching import Matches
from depthcli.methods.stereo.segments import Step
from depthcli.methods.stereo.volume import CostVolume


@dataclass(frozen=True)
class SearchRanges:
    """Where to search.

    Attributes
    ----------
    zones : (H, W) int32, 0 .. n - 1: the pixels that share a range
    limits : (n, 2) int32 lowest and highest disparity, pixels, inclusive
    """

    zones: NDArray[np.int32]
    limits: NDArray[np.int32]

    def by_segment(self, labels: NDArray[np.int32]) -> NDArray[np.int32]:
        """(n, 2) lowest and highest disparity of all zones that a segment of ``labels`` (H, W) overlaps."""
        limits = np.empty((int(labels.max()) + 1, 2), np.int32)
        limits[:] = np.iinfo(np.int32).max, -1
        np.minimum.at(limits[:, 0], labels, self.limits[self.zones, 0])
        np.maximum.at(limits[:, 1], labels, self.limits[self.zones, 1])
        return limits


class Ranges(Step):
    """The disparities of a segment's key points, and a penalty for all others."""

    margin: float = Field(
        0.25, ge=0, le=1, description="alpha (eq. 2.5): ranges grow by this part of the whole range, each side"
    )
    neighbors: int = Field(
        0,
        ge=0,
        le=1000,
        description="a segment's range also covers this many key points nearest to it; 0: only its own",
    )
    reach: float = Field(
        40.0, gt=0, le=16384, description="where they are not all this near, they do not count, pixels"
    )
    cell: int = Field(
        0, ge=0, le=4096, description="larger segments have a range for each cell of a grid this wide, pixels; 0: one"
    )
    penalty: float = Field(
        100.0, ge=0, le=65535, description="disparities outside the range cost this much more, in units of the cost"
    )

    def __call__(self, labels: NDArray[np.int32], matches: Matches | None, max_disparity: int) -> SearchRanges:
        """The ranges of the segments ``labels`` (H, W), 0 .. n - 1."""
        zones = search_zones(labels, self.cell) if self.cell else labels
        limits = search_ranges(zones, matches, max_disparity, self.margin, self.neighbors, self.reach)
        return SearchRanges(zones, limits)

    def discourage(self, volume: CostVolume, found: SearchRanges) -> CostVolume:
        """The volume with every disparity outside its zone's range dearer by ``penalty``.

        Where the image border cuts all of the range off, nothing changes. Unlike a ban, a small penalty only decides
        between matches that are about equally good: where the range of a segment misses its true disparity (all
        key points around lie on something else), the costs still find it.
        """
        costs = volume.costs
        most = np.inf if costs.dtype == np.float32 else np.iinfo(costs.dtype).max
        kind = np.float32 if costs.dtype == np.float32 else np.int32
        penalty = kind(min(self.penalty * volume.scale, 65535))
        dearer: NDArray[Any] = memory.empty(costs.shape, costs.dtype)
        _discourage(costs, found.zones, found.limits, penalty, kind(min(most, 65535)), dearer)
        return CostVolume(dearer, volume.scale)


@parallel_jit
def _discourage(costs: Any, zones: Any, ranges: Any, penalty: Any, most: Any, out: Any) -> None:
    height, width, depth = costs.shape
    for y in prange(height):
        for x in range(width):
            row = out[y, x]
            row[:] = costs[y, x]
            low = ranges[zones[y, x], 0]
            high = ranges[zones[y, x], 1]
            if low > x:
                continue
            for d in range(low):
                row[d] = min(row[d] + penalty, most)
            for d in range(high + 1, depth):
                row[d] = min(row[d] + penalty, most)


def search_zones(labels: NDArray[np.int32], cell: int) -> NDArray[np.int32]:
    """What shares a search range: every segment, cut along a grid of ``cell`` pixels; (H, W) int32, 0 .. n - 1.

    The bars of a fence are one segment, but the key points at its far end tell nothing about this one.
    """
    height, width = labels.shape
    grid = (np.arange(height)[:, None] // cell) * (width // cell + 1) + np.arange(width)[None] // cell
    keys = labels.astype(np.int64) * (int(grid.max()) + 1) + grid
    _, zones = np.unique(keys, return_inverse=True)
    return zones.reshape(labels.shape).astype(np.int32)


def search_ranges(
    labels: NDArray[np.int32],
    matches: Matches | None,
    max_disparity: int,
    margin: float,
    neighbors: int = 0,
    reach: float = np.inf,
) -> NDArray[np.int32]:
    """Lowest and highest disparity to search in every segment (eq. 2.2-2.5).

    The range of the disparities of the segment's key points, widened on both sides by ``margin`` times
    ``max_disparity``; segments without key points keep everything. Eq. 2.4 prints a minus before theta 2,
    which would exclude the key points themselves; a plus is meant.

    Parameters
    ----------
    labels : (H, W) segments 0 .. n - 1
    matches : matched key points, or None
    neighbors : the key points nearest to the segment's center that count as if they were its own, so that
        segments without any (the bars of a fence) are limited too; 0 for the thesis's rule
    reach : the farthest of them must be this near to the center, pixels

    Returns
    -------
    (n, 2) int32, both ends inclusive
    """
    count = int(labels.max()) + 1
    low = np.full(count, np.inf)
    high = np.full(count, -np.inf)
    if matches is not None:
        rows = np.clip(np.rint(matches.y).astype(int), 0, labels.shape[0] - 1)
        columns = np.clip(np.rint(matches.x).astype(int), 0, labels.shape[1] - 1)
        segment = labels[rows, columns]
        np.minimum.at(low, segment, matches.disparity)
        np.maximum.at(high, segment, matches.disparity)
        if neighbors and len(matches) >= neighbors:
            index, farthest = _nearest(labels, matches, neighbors)
            near = matches.disparity[index]
            around = farthest <= reach
            low = np.where(around, np.minimum(low, near.min(axis=1)), low)
            high = np.where(around, np.maximum(high, near.max(axis=1)), high)
    widening = margin * max_disparity
    ranges = np.empty((count, 2), np.int32)
    ranges[:, 0] = np.clip(np.floor(np.where(np.isinf(low), 0, low - widening)), 0, max_disparity)
    ranges[:, 1] = np.clip(np.ceil(np.where(np.isinf(high), max_disparity, high + widening)), 0, max_disparity)
    return ranges


def _nearest(
    labels: NDArray[np.int32], matches: Matches, neighbors: int
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """(n, neighbors) the matches nearest to the center of every segment; (n,) distance of the last of them."""
    flat = labels.ravel()
    sizes = np.maximum(np.bincount(flat), 1)
    y, x = np.divmod(np.arange(flat.size), labels.shape[1])
    center_x, center_y = np.bincount(flat, x) / sizes, np.bincount(flat, y) / sizes
    apart = (center_x[:, None] - matches.x[None]) ** 2 + (center_y[:, None] - matches.y[None]) ** 2
    order = np.argpartition(apart, neighbors - 1, axis=1)[:, :neighbors]
    return order, np.sqrt(np.take_along_axis(apart, order, axis=1).max(axis=1))
