"""Matching of key points along the epipolar lines of a rectified pair."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.keypoints import KeyPoints
from depthcli.kernels.jit import jit, parallel_jit, prange


@dataclass(frozen=True)
class Matches:
    """Matched key points of a rectified pair, in raster order.

    Attributes
    ----------
    left, right : (M,) int32 indices into the two sets of key points
    x, y : (M,) float32 position in the left image, pixels
    disparity : (M,) float32 ``x_left - x_right``, pixels
    distance : (M,) float32 Euclidean distance of the descriptors
    """

    left: NDArray[np.int32]
    right: NDArray[np.int32]
    x: NDArray[np.float32]
    y: NDArray[np.float32]
    disparity: NDArray[np.float32]
    distance: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.left)


def match_rectified(
    left: KeyPoints,
    right: KeyPoints,
    max_disparity: float,
    max_row_difference: float = 0.5,
    ratio: float = 0.7,
    max_distance: float = 0.2,
    max_scale_ratio: float = 1.1,
    min_disparity: float = 0.0,
) -> Matches:
    """Match mutual nearest neighbors in descriptor space along epipolar lines (thesis, eq. 2.1), by ratio test.

    Candidates lie less than ``max_row_difference`` rows apart, have a disparity in [``min_disparity``,
    ``max_disparity``] and the same sign of the Laplacian, and about the same scale: in a rectified pair a patch
    keeps its height. (On Cones 9 % of the matches with scales within 5 % are wrong; beyond 10 % it is 8 in 10.)
    The ratio test compares with the best candidate elsewhere on the line, at least two pixels away: two
    responses to one blob do not make it ambiguous.

    Parameters
    ----------
    left, right : key points of the two images, of one detector
    max_disparity, min_disparity : limits of ``x_left - x_right``, pixels
    max_row_difference : limit of the difference of rows, pixels
    ratio : a match must be nearer than this times the second candidate, from both sides; 1 = no test
    max_distance : farther descriptors never match; two unit vectors are at most 2 apart
    max_scale_ratio : the larger scale of a match over the smaller, at most
    """
    limits = (max_row_difference, ratio, max_scale_ratio)
    nearest, distance = _search(left, right, min_disparity, max_disparity, *limits)
    back, _ = _search(right, left, -max_disparity, -min_disparity, *limits)
    one = np.flatnonzero((nearest >= 0) & (distance <= max_distance)).astype(np.int32)
    one = one[back[nearest[one]] == one]
    other = nearest[one]
    raster = np.lexsort((left.x[one], left.y[one]))
    one, other = one[raster], other[raster]
    x = left.x[one]
    return Matches(one, other, x, left.y[one], x - right.x[other], distance[one])


def _search(
    points: KeyPoints, others: KeyPoints, low: float, high: float, rows: float, ratio: float, max_scale_ratio: float
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    # For each of ``points`` the index of the nearest of ``others``, -1: none; and its distance. ``low`` and ``high``
    # limit x - x', ``rows`` the difference of y.
    order = np.lexsort((others.x, others.y)).astype(np.int32)
    first = np.searchsorted(others.y[order], points.y - rows, side="right").astype(np.int32)
    last = np.searchsorted(others.y[order], points.y + rows, side="left").astype(np.int32)
    nearest, distance = _nearest(
        points.x,
        points.sign,
        points.scale,
        points.descriptors,
        others.x[order],
        others.sign[order],
        others.scale[order],
        others.descriptors[order],
        first,
        last,
        low,
        high,
        ratio,
        max_scale_ratio,
    )
    return np.append(order, np.int32(-1))[nearest], distance


@jit
def _comparable(shift, low, high, sign, other_sign, scale, other_scale, max_scale_ratio):
    if shift < low or shift > high or sign != other_sign:
        return False
    return scale <= max_scale_ratio * other_scale and other_scale <= max_scale_ratio * scale


@parallel_jit
def _nearest(
    x,
    sign,
    scale,
    descriptors,
    other_x,
    other_sign,
    other_scale,
    other_descriptors,
    low,
    high,
    min_shift,
    max_shift,
    ratio,
    max_scale_ratio,
):
    # Nearest candidate of each key point, -1 where there is none or the second is too near; and its distance.
    count = x.size
    nearest = np.full(count, -1, np.int32)
    distance = np.full(count, np.inf, np.float32)
    for k in prange(count):
        here = descriptors[k]
        best = np.float32(np.inf)
        winner = -1
        for j in range(low[k], high[k]):
            shift = x[k] - other_x[j]
            if not _comparable(
                shift, min_shift, max_shift, sign[k], other_sign[j], scale[k], other_scale[j], max_scale_ratio
            ):
                continue
            there = other_descriptors[j]
            total = np.float32(0.0)
            for i in range(here.size):
                difference = here[i] - there[i]
                total += difference * difference
            if total < best:
                best = total
                winner = j
        if winner < 0:
            continue
        second = np.float32(np.inf)
        for j in range(low[k], high[k]):
            shift = x[k] - other_x[j]
            if not _comparable(
                shift, min_shift, max_shift, sign[k], other_sign[j], scale[k], other_scale[j], max_scale_ratio
            ):
                continue
            if abs(other_x[j] - other_x[winner]) < 2.0:
                continue
            there = other_descriptors[j]
            total = np.float32(0.0)
            for i in range(here.size):
                difference = here[i] - there[i]
                total += difference * difference
            second = min(second, total)
        if ratio >= 1.0 or best < ratio * ratio * second:
            nearest[k] = winner
            distance[k] = np.sqrt(best)
    return nearest, distance


def consistent(matches: Matches, neighbors: int = 8, agreeing: int = 2, tolerance: float = 2.0) -> Matches:
    """Return the matches whose disparity some of the matches around them share.

    A blob that straddles the rim of an object is matched, but by the object, not by the ground it lies on.

    Parameters
    ----------
    neighbors : number of the nearest matches that are compared
    agreeing : number of them that must have a disparity within ``tolerance``
    tolerance : largest difference of disparities that agree, pixels
    """
    index, _ = nearest_points(matches.x, matches.y, matches.x, matches.y, min(neighbors + 1, len(matches)))
    # The match itself is one of these, first but for others at the same place; without it they are the neighbors.
    own = index == np.arange(len(matches))[:, None]
    own[~own.any(axis=1), -1:] = True
    agrees = np.abs(matches.disparity[index] - matches.disparity[:, None]) <= tolerance
    kept = np.count_nonzero(agrees & ~own, axis=1) >= agreeing
    return Matches(*(getattr(matches, name)[kept] for name in Matches.__dataclass_fields__))


def nearest_points(
    center_x: NDArray[Any], center_y: NDArray[Any], x: NDArray[Any], y: NDArray[Any], count: int
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the ``count`` of the (M,) points nearest to every one of (N,) centers, the nearest first.

    Returns
    -------
    index : (N, count) int64; of equally distant points the one that comes first is nearer
    squared : (N, count) float64 squared distances
    """
    index = np.zeros((len(center_x), count), np.int64)
    squared = np.full((len(center_x), count), np.inf)
    if count:
        center_x, center_y, x, y = (np.asarray(one, np.float64) for one in (center_x, center_y, x, y))
        _insert_nearest(center_x, center_y, x, y, index, squared)
    return index, squared


@parallel_jit
def _insert_nearest(center_x, center_y, x, y, index, squared):
    for n in prange(index.shape[0]):
        nearest, distances = index[n], squared[n]
        last = distances.size - 1
        for m in range(x.size):
            distance = (center_x[n] - x[m]) ** 2 + (center_y[n] - y[m]) ** 2
            if distance >= distances[last]:
                continue
            place = last
            while place > 0 and distances[place - 1] > distance:
                distances[place] = distances[place - 1]
                nearest[place] = nearest[place - 1]
                place -= 1
            distances[place] = distance
            nearest[place] = m
