"""First disparities of the segment-based pipeline: search ranges, window inside the segment, cross-check."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.core import memory
from depthcli.kernels.jit import jit, parallel_jit, prange
from depthcli.kernels.winners import left_right_difference, winners
from depthcli.keypoints._matching import Matches
from depthcli.stereo.fixed_point import FixedPoint, as_fixed_point
from depthcli.stereo.refinement.subpixel import move_to_minimum
from depthcli.stereo.volume import CostVolume


@dataclass(frozen=True)
class FirstEstimate:
    """Disparities before any plane.

    Attributes
    ----------
    values : (H, W) float32, pixels, to a fraction of a pixel
    trusted : (H, W) bool: the right view agrees
    right : (H, W) uint16 disparities of the right view
    """

    values: NDArray[np.float32]
    trusted: NDArray[np.bool_]
    right: NDArray[np.uint16]


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


def segment_window(volume: CostVolume, labels: NDArray[np.int32], radius: int) -> CostVolume:
    """Mean cost over those pixels of a square window that lie in the center's own segment.

    Returns
    -------
    CostVolume
        uint16 fixed point, sixteen times as fine as a uint8 volume's unit.
    """
    fixed = as_fixed_point(volume) if volume.costs.dtype != np.uint8 else volume
    out = memory.empty(fixed.costs.shape, np.uint16)
    sharper = FixedPoint.FRACTION if volume.costs.dtype == np.uint8 else 1
    # Up to 257 uint8 costs fit into a uint16 sum, which is twice as fast.
    small = volume.costs.dtype == np.uint8 and (2 * radius + 1) ** 2 <= 257
    total = np.zeros(1, np.uint16 if small else np.uint32)
    _segment_window(fixed.costs, labels, radius, np.float32(sharper), total, out)
    return CostVolume(out, fixed.scale * sharper)


@parallel_jit
def _segment_window(costs: Any, labels: Any, radius: Any, sharper: Any, kind: Any, out: Any) -> None:
    height, width, depth = costs.shape
    half = np.float32(0.5)
    for y in prange(height):
        total = np.zeros(depth, kind.dtype)
        for x in range(width):
            total[:] = 0
            label = labels[y, x]
            count = 0
            for j in range(max(0, y - radius), min(height, y + radius + 1)):
                for k in range(max(0, x - radius), min(width, x + radius + 1)):
                    if labels[j, k] != label:
                        continue
                    count += 1
                    row = costs[j, k]
                    for i in range(total.size):
                        total[i] += row[i]
            factor = sharper / np.float32(count)
            target = out[y, x]
            for i in range(total.size):
                target[i] = np.uint16(np.int32(np.float32(total[i]) * factor + half))


def search_zones(labels: NDArray[np.int32], cell: int) -> NDArray[np.int32]:
    """What shares a search range: every segment, cut along a grid of ``cell`` pixels; (H, W) int32, 0 .. n - 1.

    The bars of a fence are one segment, but the key points at its far end tell nothing about this one.
    """
    height, width = labels.shape
    grid = (np.arange(height)[:, None] // cell) * (width // cell + 1) + np.arange(width)[None] // cell
    keys = labels.astype(np.int64) * (int(grid.max()) + 1) + grid
    _, zones = np.unique(keys, return_inverse=True)
    return zones.reshape(labels.shape).astype(np.int32)


def discourage_outside(
    volume: CostVolume, zones: NDArray[np.int32], ranges: NDArray[np.int32], penalty: float
) -> CostVolume:
    """Make every disparity outside its zone's range dearer by ``penalty``, in units of the cost; in place.

    Where the image border cuts all of the range off, nothing changes. Unlike a ban, a small penalty only decides
    between matches that are about equally good: where the range of a segment misses its true disparity (all
    key points around lie on something else), the costs still find it.
    """
    costs = volume.costs
    most = np.inf if costs.dtype == np.float32 else np.iinfo(costs.dtype).max
    kind = np.float32 if costs.dtype == np.float32 else np.int32
    _discourage(costs, zones, ranges, kind(min(penalty * volume.scale, 65535)), kind(min(most, 65535)))
    return volume


@parallel_jit
def _discourage(costs: Any, zones: Any, ranges: Any, penalty: Any, most: Any) -> None:
    height, width, depth = costs.shape
    for y in prange(height):
        for x in range(width):
            low = ranges[zones[y, x], 0]
            high = ranges[zones[y, x], 1]
            if low > x:
                continue
            row = costs[y, x]
            for d in range(low):
                row[d] = min(row[d] + penalty, most)
            for d in range(high + 1, depth):
                row[d] = min(row[d] + penalty, most)


def select(volume: CostVolume, tolerance: float, subpixel: bool) -> FirstEstimate:
    """Winner takes all for both views and cross-check; where wanted, a parabola for the fraction of a pixel.

    A pixel is trusted where the right view's disparity differs by at most ``tolerance`` and the costs are not all the
    same: on a flat image any disparity would pass the check.
    """
    left, right = winners(volume.costs)
    trusted = left_right_difference(left, right) <= tolerance
    _distrust_indifferent(volume.costs, trusted)
    values = left.astype(np.float32)
    if subpixel:
        move_to_minimum(volume.costs, values)
    return FirstEstimate(values, trusted, right)


def tells_anything(volume: CostVolume) -> bool:
    """Whether any pixel has different costs for disparities inside the right image: not so on a flat image."""
    return bool(_tells_anything(volume.costs))


@jit
def _tells_anything(costs: Any) -> Any:
    height, width, depth = costs.shape
    for y in range(height):
        for x in range(width):
            for d in range(1, min(depth, x + 1)):
                if costs[y, x, d] != costs[y, x, 0]:
                    return True
    return depth == 1


@parallel_jit
def _distrust_indifferent(costs: Any, trusted: Any) -> None:
    height, width, depth = costs.shape
    for y in prange(height):
        for x in range(width):
            if not trusted[y, x]:
                continue
            row = costs[y, x, : min(depth, x + 1)]
            low = np.int64(65536)
            high = np.int64(-1)
            for i in range(row.size):
                cost = np.int64(row[i])
                low = min(low, cost)
                high = max(high, cost)
            trusted[y, x] = high > low or depth == 1
