"""Search ranges of segments from matched key points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.algorithms.nearest import nearest_points
from depthcli.algorithms.regions import region_sums
from depthcli.core import memory
from depthcli.core.method import ConfigModel
from depthcli.kernels.jit import jit, run_bands
from depthcli.methods.stereo.keypoint_matching import Matches
from depthcli.methods.stereo.segments.first_estimate import grid_parts
from depthcli.methods.stereo.volume import CostVolume


@dataclass(frozen=True)
class SearchRanges:
    """Disparities to search."""

    zones: NDArray[np.int32]  # (H, W), 0 .. n - 1; pixels of a zone share a range
    limits: NDArray[np.int32]  # (n, 2) lowest and highest disparity, pixels, inclusive

    def by_segment(self, labels: NDArray[np.int32]) -> NDArray[np.int32]:
        """Return the (n, 2) lowest and highest disparities over the zones that each segment of ``labels`` overlaps."""
        limits = np.empty((int(labels.max()) + 1, 2), np.int32)
        limits[:] = np.iinfo(np.int32).max, -1
        np.minimum.at(limits[:, 0], labels, self.limits[self.zones, 0])
        np.maximum.at(limits[:, 1], labels, self.limits[self.zones, 1])
        return limits


class Ranges(ConfigModel):
    """Search every segment around the disparities of its key points, and penalize all others."""

    margin: float = Field(
        0.25, ge=0, le=1, description="growth of ranges on each side, share of the whole range (thesis, eq. 2.5: alpha)"
    )
    neighbors: int = Field(
        0, ge=0, le=1000, description="number of nearest key points that define the range of a segment"
    )
    reach: float = Field(
        40.0,
        gt=0,
        le=16384,
        description="largest distance of the nearest key points; if one is farther, there is no range, pixels",
    )
    cell: int = Field(0, ge=0, le=4096, description="width of a segment's parts with own ranges, pixels; 0: one range")
    penalty: float = Field(
        100.0, ge=0, le=65535, description="cost added outside a segment's search range, in units of the cost"
    )

    def __call__(self, labels: NDArray[np.int32], matches: Matches | None, max_disparity: int) -> SearchRanges:
        """Return the ranges of the segments ``labels`` (H, W), 0 .. n - 1 (thesis, eq. 2.2-2.5).

        A range is that of the disparities of the segment's key points, widened on both sides; segments without key
        points keep the whole range. The minus before theta 2 (thesis, eq. 2.4) would exclude the key points themselves;
        a plus is used.
        """
        zones, count = labels, int(labels.max()) + 1
        if self.cell:
            # In a segment of large extent, such as the bars of a fence, distant key points say nothing about a place.
            zones, count = grid_parts(labels, self.cell, np.ones(count, np.bool_))
        low = np.full(count, np.inf)
        high = np.full(count, -np.inf)
        if matches is not None:
            rows = np.clip(np.rint(matches.y).astype(int), 0, zones.shape[0] - 1)
            columns = np.clip(np.rint(matches.x).astype(int), 0, zones.shape[1] - 1)
            np.minimum.at(low, zones[rows, columns], matches.disparity)
            np.maximum.at(high, zones[rows, columns], matches.disparity)
        if matches is not None and 0 < self.neighbors <= len(matches):
            sizes, sums = region_sums(zones, np.dstack([*np.indices(zones.shape, np.float32)]), count)
            y, x = np.ascontiguousarray((sums / np.maximum(sizes, 1)[:, None]).T)
            index = nearest_points(x, y, matches.x, matches.y, self.neighbors)
            farthest = index[:, -1]
            near = np.ascontiguousarray(matches.disparity[index].T)  # minima along a short last axis take long
            within = np.sqrt((x - matches.x[farthest]) ** 2 + (y - matches.y[farthest]) ** 2) <= self.reach
            low = np.where(within, np.minimum(low, near.min(axis=0)), low)
            high = np.where(within, np.maximum(high, near.max(axis=0)), high)
        widening = self.margin * max_disparity
        limits = np.empty((count, 2), np.int32)
        limits[:, 0] = np.clip(np.floor(np.where(np.isinf(low), 0, low - widening)), 0, max_disparity)
        limits[:, 1] = np.clip(np.ceil(np.where(np.isinf(high), max_disparity, high + widening)), 0, max_disparity)
        return SearchRanges(zones, limits)

    def penalize(self, volume: CostVolume, ranges: SearchRanges) -> CostVolume:
        """Return the volume with ``penalty`` added to every disparity outside its zone's range.

        Pixels whose whole range lies outside the right image keep their costs. Unlike a ban, a small penalty
        only decides between matches of similar cost: where the range misses the true disparity (all key points around
        lie on something else), the costs still select it.
        """
        costs = volume.costs
        limit = np.inf if costs.dtype == np.float32 else np.iinfo(costs.dtype).max
        kind = np.float32 if costs.dtype == np.float32 else np.int32
        penalty = kind(min(self.penalty * volume.scale, limit))
        penalized: NDArray[Any] = memory.empty(costs.shape, costs.dtype)
        run_bands(_penalize, len(costs), costs, ranges.zones, ranges.limits, penalty, kind(limit), penalized)
        return CostVolume(penalized, volume.scale)


@jit
def _penalize(begin, end, costs, zones, ranges, penalty, limit, out):
    _, width, n_disparities = costs.shape
    for y in range(begin, end):
        for x in range(width):
            row = out[y, x]
            for d in range(n_disparities):
                row[d] = costs[y, x, d]
            low = ranges[zones[y, x], 0]
            high = ranges[zones[y, x], 1]
            if low > x:
                continue
            for d in range(low):
                row[d] = min(row[d] + penalty, limit)
            for d in range(high + 1, n_disparities):
                row[d] = min(row[d] + penalty, limit)
