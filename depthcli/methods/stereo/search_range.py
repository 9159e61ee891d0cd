"""Which disparities are searched, and how a pair is shifted so that its smallest disparity is 0."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.keypoints.surf import Surf
from depthcli.core.errors import InputError
from depthcli.core.frames import Image, StereoPair
from depthcli.core.maps import DisparityMap, Status
from depthcli.methods.stereo.keypoint_matching import consistent, match_rectified
from depthcli.methods.stereo.volume import StereoResult

_MAX_PIXELS = 600_000  # larger images are reduced to this size for key points: more of them do not change the range
_MAX_ROW_DIFFERENCE = 1.0  # of matched key points, pixels
_MIN_SHIFT, _MAX_SHIFT = -0.5, 0.75  # disparities among which key points are matched, shares of the width
_TAIL = 0.005  # share of the matches that are ignored at either end: some are wrong
_MIN_MATCHES = 16  # with fewer, quantiles mean nothing
# The nearest and the farthest things seldom have key points; on the Middlebury scenes of 2001 to 2014 at most 0.4 % of
# the true disparities lie beyond these margins (shares of the range between the quantiles), on KITTI 1.8 %.
_MARGIN_ABOVE, _MARGIN_BELOW, _MIN_MARGIN_PX = 0.3, 0.2, 4.0


@dataclass(frozen=True)
class SearchRange:
    """Disparities ``min_disparity`` .. ``max_disparity``, both inclusive, pixels."""

    min_disparity: int
    max_disparity: int

    @property
    def shifted_max_disparity(self) -> int:
        """Return the largest disparity of the shifted pair, whose smallest is 0."""
        return self.max_disparity - self.min_disparity

    def shift(self, pair: StereoPair) -> StereoPair:
        """Return the pair whose smallest disparity is 0; the pair itself where that is so already.

        Columns are cut off where ``min_disparity`` is positive, since nothing to the left of them can be matched, and
        repeated where it is negative: every other match keeps its place, inside or outside the right image.
        """
        if self.min_disparity == 0:
            return pair
        width = pair.shape[1]
        if self.min_disparity >= width:
            raise InputError(f"the smallest disparity is {self.min_disparity}, but the images are {width} pixels wide")
        before, behind = max(self.min_disparity, 0), max(-self.min_disparity, 0)
        left, right = pair.left[:, before:].copy(), pair.right[:, : width - before].copy()
        if behind:
            left = cast(Image, cv2.copyMakeBorder(left, 0, 0, behind, 0, cv2.BORDER_REPLICATE))
            right = cast(Image, cv2.copyMakeBorder(right, 0, 0, 0, behind, cv2.BORDER_REPLICATE))
        return StereoPair(left, right, pair.bits)

    def restore(self, result: StereoResult, width: int) -> StereoResult:
        """Return the shifted pair's result in the pixels and disparities of the pair, which is ``width`` wide.

        Pixels without a partner in the right image, whatever their disparity, are occluded; they are filled by
        the values next to them where the map has no holes, else they stay empty.
        """
        if self.min_disparity == 0:
            return result
        values, status = (self._to_pair(part) for part in (result.disparity.values, result.disparity.status))
        values = values + np.float32(self.min_disparity)
        fills = not np.isnan(result.disparity.values).any()
        if self.min_disparity > 0:
            outside = np.broadcast_to(np.arange(width) < self.min_disparity, values.shape)
        else:
            partner = np.arange(width, dtype=np.float32)[None] - np.nan_to_num(values)
            outside = (partner > width - 0.5) & ((status & Status.FILLED) == 0) & ~np.isnan(values)
        if fills:
            status = np.where(outside, Status.OCCLUDED | Status.FILLED, status)
        else:
            values, status = np.where(outside, np.float32(np.nan), values), np.where(outside, Status.OCCLUDED, status)
        return replace(
            result,
            disparity=DisparityMap(values.astype(np.float32), status.astype(np.uint8)),
            confidence={name: self._to_pair(part) for name, part in result.confidence.items()},
            pictures={name: self._to_pair(part) for name, part in result.pictures.items()},
        )

    def _to_pair(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return values of the shifted pair, (H, W', ...), at the pair's width; new columns repeat the first one."""
        if self.min_disparity < 0:
            return np.ascontiguousarray(values[:, -self.min_disparity :])
        return np.pad(values, ((0, 0), (self.min_disparity, 0), *(((0, 0),) * (values.ndim - 2))), mode="edge")

    def share_at_ends(self, disparity: DisparityMap) -> tuple[float, float]:
        """Return the shares of measured pixels whose disparity is within 1 of the range's lower and upper end."""
        values = disparity.values[disparity.measured]
        ends = values < self.min_disparity + 1, values > self.max_disparity - 1
        low, top = (int(np.count_nonzero(end)) / max(values.size, 1) for end in ends)
        return low, top


class KeyPointRange(NamedTuple):
    """Disparities of ``n_matches`` matched key points, with a margin: ``low`` .. ``top``, both inclusive, pixels."""

    low: int
    top: int
    n_matches: int

    @property
    def suggested(self) -> SearchRange:
        """Return the range, widened to include disparities 0 and 1."""
        return SearchRange(min(self.low, 0), max(self.top, 1))

    def union(self, other: KeyPointRange) -> KeyPointRange:
        """Return the smallest range that holds both."""
        return KeyPointRange(min(self.low, other.low), max(self.top, other.top), self.n_matches + other.n_matches)


def range_of_key_points(pair: StereoPair) -> KeyPointRange:
    """Return the range of the disparities of matched key points, with a margin; InputError where too few match."""
    height, width = pair.shape
    shrink = min(1.0, (_MAX_PIXELS / (height * width)) ** 0.5)
    size = (max(1, round(width * shrink)), max(1, round(height * shrink)))
    detect = Surf(threshold=1e-6)
    left, right = (
        detect(np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)) for image in pair.grey8
    )
    largest, smallest = _MAX_SHIFT * size[0], _MIN_SHIFT * size[0]
    found = consistent(match_rectified(left, right, largest, _MAX_ROW_DIFFERENCE, min_disparity=smallest))
    if len(found) < _MIN_MATCHES:
        raise InputError(
            f"only {len(found)} key points match, too few to find the search range; say max_disparity (views "
            "swapped, or not rectified? see depthcli rectify)"
        )
    low, high = np.quantile(found.disparity.astype(np.float64), (_TAIL, 1 - _TAIL)) * (width / size[0])
    below, above = (max(_MIN_MARGIN_PX, share * (high - low)) for share in (_MARGIN_BELOW, _MARGIN_ABOVE))
    return KeyPointRange(int(np.floor(low - below)), int(np.ceil(high + above)), len(found))


def complete_range(
    min_disparity: int | str, max_disparity: int | str | None, pair: StereoPair, known: KeyPointRange | None = None
) -> tuple[SearchRange, dict[str, int]]:
    """Replace ends that are "auto" by those of key points, and a missing upper end by the range that they suggest.

    ``known`` is the range of the key points of the pair's sequence; None: that of the pair's own. Returned are the
    range and, where an end is "auto", columns of the report: number of matches and the range of the key points.
    InputError where the range is empty, or too few key points match.
    """
    columns = {}
    if max_disparity is None or "auto" in (min_disparity, max_disparity):
        found = known or range_of_key_points(pair)
        low, top = found.low, found.top
        if max_disparity is None:
            low, max_disparity = found.suggested.min_disparity, found.suggested.max_disparity
            min_disparity = min_disparity or "auto"
        else:
            columns = {"range_matches": found.n_matches, "range_low": low, "range_top": top}
        min_disparity = low if min_disparity == "auto" else min_disparity
        max_disparity = top if max_disparity == "auto" else max_disparity
        if columns and top <= int(min_disparity):
            raise InputError(
                f"key points have disparities from {low} to {top}, but {min_disparity} is the smallest that is "
                "searched: check that the views are not swapped; otherwise lower min_disparity"
            )
    search = SearchRange(int(min_disparity), int(max_disparity))
    if search.shifted_max_disparity <= 0:
        raise InputError(f"disparities from {min_disparity} to {max_disparity} are to be searched, which are none")
    return search, columns
