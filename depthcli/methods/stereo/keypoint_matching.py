"""Matching of key points along the epipolar lines of a rectified pair."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.algorithms.keypoints import KeyPoints
from depthcli.algorithms.nearest import nearest_points
from depthcli.core.maps import Floats, Ints
from depthcli.core.method import ConfigModel
from depthcli.kernels.jit import helper, jit, run_bands

_MAX_ROW_DIFFERENCE = 0.5  # rows; thesis, eq. 2.1
_NEIGHBORS, _TOLERANCE = 8, 2.0  # matches around one, and the difference of disparities that agree, pixels


@dataclass(frozen=True)
class Matches:
    """M matched key points of a rectified pair, in raster order."""

    left: Ints  # indices into the two sets of key points
    right: Ints
    x: Floats  # position in the left image, pixels
    y: Floats
    disparity: Floats  # x_left - x_right, pixels
    distance: Floats  # Euclidean, between the descriptors

    def __len__(self) -> int:
        return len(self.left)


class KeyPointMatching(ConfigModel):
    """Match key points along the rows of a rectified pair, see :meth:`__call__` and :func:`consistent`."""

    ratio: float = Field(
        0.7,
        gt=0,
        le=1,
        description="largest distance of a match, as a share of the distance of the second candidate; 1: no test",
    )
    max_distance: float = Field(0.2, gt=0, le=2, description="largest distance of two descriptors of length 1")
    max_scale_ratio: float = Field(1.1, ge=1, le=100, description="largest ratio of the scales of two key points")
    agreeing: int = Field(
        2, ge=0, le=8, description="matches among the nearest eight that must have a similar disparity; 0: all are kept"
    )

    def __call__(self, left: KeyPoints, right: KeyPoints, max_disparity: float) -> Matches:
        """Return mutual nearest neighbors in descriptor space along epipolar lines (thesis, eq. 2.1), by ratio test.

        Candidates are less than half a row apart. They have a disparity in [0, ``max_disparity``], the same sign of the
        Laplacian, and about the same scale, because in a rectified pair a patch keeps its height. (On Cones, 9 % of the
        matches with scales within 5 % are incorrect, and 8 in 10 beyond 10 %.) The ratio test compares a match with the
        best candidate at least two pixels away, so that two responses to one blob do not make it ambiguous. Matches
        must pass from both sides.
        """

        def search(points: KeyPoints, others: KeyPoints, low: float, high: float) -> tuple[NDArray[Any], NDArray[Any]]:
            # For each of ``points``, the index of the nearest of ``others`` with x - x' from low to high (-1: none),
            # and its distance.
            order = np.lexsort((others.x, others.y)).astype(np.int32)
            rows = others.y[order]
            first = np.searchsorted(rows, points.y - _MAX_ROW_DIFFERENCE, side="right").astype(np.int32)
            last = np.searchsorted(rows, points.y + _MAX_ROW_DIFFERENCE, side="left").astype(np.int32)
            own = points.x, points.sign, points.scale, points.descriptors
            other = others.x[order], others.sign[order], others.scale[order], others.descriptors[order]
            nearest, distance = np.full(len(points), -1, np.int32), np.full(len(points), np.inf, np.float32)
            limits = float(low), float(high), float(self.ratio), float(self.max_scale_ratio)  # one type: compiled once
            run_bands(_find_nearest, len(points), *own, *other, first, last, limits, nearest, distance)
            return np.append(order, np.int32(-1))[nearest], distance

        nearest, distance = search(left, right, 0.0, max_disparity)
        back, _ = search(right, left, -max_disparity, 0.0)
        one = np.flatnonzero((nearest >= 0) & (distance <= self.max_distance)).astype(np.int32)
        one = one[back[nearest[one]] == one]
        other = nearest[one]
        raster = np.lexsort((left.x[one], left.y[one]))
        one, other = one[raster], other[raster]
        x = left.x[one]
        found = Matches(one, other, x, left.y[one], x - right.x[other], distance[one])
        return consistent(found, self.agreeing) if self.agreeing else found


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


def consistent(matches: Matches, agreeing: int) -> Matches:
    """Return the matches whose disparity agrees with matches around them.

    A blob across the rim of an object takes the object's disparity, even where its center is on the background. At
    least ``agreeing`` of the nearest eight must have a disparity within two pixels.
    """
    index = nearest_points(matches.x, matches.y, matches.x, matches.y, min(_NEIGHBORS + 1, len(matches)))
    # Leave out the match itself; if too many others at the same place precede it, leave out the last one instead.
    own = index == np.arange(len(matches))[:, None]
    own[~own.any(axis=1), -1:] = True
    agrees = np.abs(matches.disparity[index] - matches.disparity[:, None]) <= _TOLERANCE
    kept = np.count_nonzero(agrees & ~own, axis=1) >= agreeing
    return Matches(*(getattr(matches, name)[kept] for name in Matches.__dataclass_fields__))
