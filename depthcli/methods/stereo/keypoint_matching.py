"""Matching of key points along the epipolar lines of a rectified pair."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.algorithms.keypoints import KeyPoints
from depthcli.core.method import ConfigModel
from depthcli.kernels.jit import helper, jit, run_bands


@dataclass(frozen=True)
class Matches:
    """M matched key points of a rectified pair, in raster order."""

    left: NDArray[np.int32]  # indices into the two sets of key points
    right: NDArray[np.int32]
    x: NDArray[np.float32]  # position in the left image, pixels
    y: NDArray[np.float32]
    disparity: NDArray[np.float32]  # x_left - x_right, pixels
    distance: NDArray[np.float32]  # Euclidean, between the descriptors

    def __len__(self) -> int:
        return len(self.left)


class KeyPointMatching(ConfigModel):
    """Match key points along the rows of a rectified pair, see :func:`match_rectified` and :func:`consistent`."""

    ratio: float = Field(
        0.7, gt=0, le=1, description="largest distance of a match, share of that of the second candidate; 1: no test"
    )
    max_distance: float = Field(0.2, gt=0, le=2, description="largest distance of two descriptors of length 1")
    max_scale_ratio: float = Field(1.1, ge=1, le=100, description="largest ratio of the scales of two key points")
    agreeing: int = Field(
        2, ge=0, le=8, description="matches among the nearest eight that must have a similar disparity; 0: all are kept"
    )

    def __call__(self, left: KeyPoints, right: KeyPoints, max_disparity: float) -> Matches:
        """Return the matches of the key points of two views, with disparities up to ``max_disparity``."""
        limits = self.ratio, self.max_distance, self.max_scale_ratio
        found = match_rectified(left, right, max_disparity, 0.5, *limits)
        return consistent(found, agreeing=self.agreeing) if self.agreeing else found


def match_rectified(
    left: KeyPoints,
    right: KeyPoints,
    max_disparity: float,
    max_row_difference: float = 0.5,
    ratio: float = 0.7,
    max_distance: float = 0.2,
    max_scale_ratio: float = 1.1,
) -> Matches:
    """Return mutual nearest neighbors in descriptor space along epipolar lines (thesis, eq. 2.1), by ratio test.

    Candidates are less than ``max_row_difference`` rows apart. They have a disparity in [0, ``max_disparity``], the
    same sign of the Laplacian, and about the same scale, because in a rectified pair a patch keeps its height. (On
    Cones, 9 % of the matches with scales within 5 % are incorrect, and 8 in 10 beyond 10 %.) The ratio test compares a
    match with the best candidate at least two pixels away, so that two responses to one blob do not make it ambiguous.
    From both sides a match must be nearer than ``ratio`` times the second candidate (1: no test), and at most
    ``max_distance``; two unit vectors are at most 2 apart.
    """

    def search(points: KeyPoints, others: KeyPoints, low: float, high: float) -> tuple[NDArray[Any], NDArray[Any]]:
        # For each of ``points``, the index of the nearest of ``others`` with x - x' from low to high (-1: none), and
        # its distance.
        order = np.lexsort((others.x, others.y)).astype(np.int32)
        rows = others.y[order]
        first = np.searchsorted(rows, points.y - max_row_difference, side="right").astype(np.int32)
        last = np.searchsorted(rows, points.y + max_row_difference, side="left").astype(np.int32)
        own = points.x, points.sign, points.scale, points.descriptors
        other = others.x[order], others.sign[order], others.scale[order], others.descriptors[order]
        nearest, distance = np.full(len(points), -1, np.int32), np.full(len(points), np.inf, np.float32)
        limits = float(low), float(high), float(ratio), float(max_scale_ratio)  # one type: compiled once
        run_bands(_find_nearest, len(points), *own, *other, first, last, limits, nearest, distance)
        return np.append(order, np.int32(-1))[nearest], distance

    nearest, distance = search(left, right, 0.0, max_disparity)
    back, _ = search(right, left, -max_disparity, 0.0)
    one = np.flatnonzero((nearest >= 0) & (distance <= max_distance)).astype(np.int32)
    one = one[back[nearest[one]] == one]
    other = nearest[one]
    raster = np.lexsort((left.x[one], left.y[one]))
    one, other = one[raster], other[raster]
    x = left.x[one]
    return Matches(one, other, x, left.y[one], x - right.x[other], distance[one])


@jit
def _find_nearest(
    begin, end, x, sign, scale, descriptors, other_x, other_sign, other_scale, other_descriptors, low, high, limits,
    nearest, distance,
):  # fmt: skip
    # Nearest candidate of each key point, and its distance; -1 if there is none or the second is too near.
    min_shift, max_shift, ratio, max_scale_ratio = limits
    for k in range(begin, end):
        winner = -1
        best = second = np.float32(np.inf)
        for turn in range(2):  # then the best candidate at another place than the nearest one
            for j in range(low[k], high[k]):
                shift = x[k] - other_x[j]
                if shift < min_shift or shift > max_shift or sign[k] != other_sign[j]:
                    continue
                if scale[k] > max_scale_ratio * other_scale[j] or other_scale[j] > max_scale_ratio * scale[k]:
                    continue
                if turn == 1 and abs(other_x[j] - other_x[winner]) < 2.0:
                    continue
                total = _squared_distance(descriptors[k], other_descriptors[j])
                if turn == 1:
                    second = min(second, total)
                elif total < best:
                    best = total
                    winner = j
            if winner < 0:
                break
        if winner >= 0 and (ratio >= 1.0 or best < ratio * ratio * second):
            nearest[k] = winner
            distance[k] = np.sqrt(best)


@helper
def _squared_distance(here, there):
    total = np.float32(0.0)
    for i in range(here.size):
        difference = here[i] - there[i]
        total += difference * difference
    return total


def consistent(matches: Matches, neighbors: int = 8, agreeing: int = 2, tolerance: float = 2.0) -> Matches:
    """Return the matches whose disparity agrees with matches around them.

    A blob across the rim of an object takes the object's disparity, even where its center is on the background. At
    least ``agreeing`` of the nearest ``neighbors`` must have a disparity within ``tolerance`` pixels.
    """
    index, _ = nearest_points(matches.x, matches.y, matches.x, matches.y, min(neighbors + 1, len(matches)))
    # Leave out the match itself; if too many others at the same place precede it, leave out the last one instead.
    own = index == np.arange(len(matches))[:, None]
    own[~own.any(axis=1), -1:] = True
    agrees = np.abs(matches.disparity[index] - matches.disparity[:, None]) <= tolerance
    kept = np.count_nonzero(agrees & ~own, axis=1) >= agreeing
    return Matches(*(getattr(matches, name)[kept] for name in Matches.__dataclass_fields__))


def nearest_points(
    center_x: NDArray[Any], center_y: NDArray[Any], x: NDArray[Any], y: NDArray[Any], count: int
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the indices of the ``count`` of (M,) points nearest to each of (N,) centers, and their squared distances.

    Both are (N, count), the nearest first; among equally distant points, the earlier one is first.
    """
    index = np.zeros((len(center_x), count), np.int64)
    squared = np.full((len(center_x), count), np.inf)
    if count:
        center_x, center_y, x, y = (np.asarray(one, np.float64) for one in (center_x, center_y, x, y))
        by_row = np.argsort(y)
        run_bands(_insert_nearest, len(index), center_x, center_y, x[by_row], y[by_row], by_row, index, squared)
    return index, squared


@jit
def _insert_nearest(begin, end, center_x, center_y, x, y, name, index, squared):
    # Points are sorted by ``y`` and have the index ``name``; they are visited up and down from the center's row.
    for n in range(begin, end):
        nearest, distances = index[n], squared[n]
        last = distances.size - 1
        below = np.searchsorted(y, center_y[n])
        above = below - 1
        while above >= 0 or below < y.size:
            up = center_y[n] - y[above] if above >= 0 else np.inf
            down = y[below] - center_y[n] if below < y.size else np.inf
            if min(up, down) ** 2 > distances[last]:
                break
            if down <= up:
                m = below
                below += 1
            else:
                m = above
                above -= 1
            distance = (center_x[n] - x[m]) ** 2 + (center_y[n] - y[m]) ** 2
            if not _comes_before(distance, name[m], distances[last], nearest[last]):
                continue
            place = last
            while place > 0 and _comes_before(distance, name[m], distances[place - 1], nearest[place - 1]):
                distances[place] = distances[place - 1]
                nearest[place] = nearest[place - 1]
                place -= 1
            distances[place] = distance
            nearest[place] = name[m]


@helper
def _comes_before(distance, name, other_distance, other_name):
    return distance < other_distance or (distance == other_distance and name < other_name)
