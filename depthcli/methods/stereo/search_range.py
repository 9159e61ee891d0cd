"""The disparities to search, and the shift of a pair that makes its smallest disparity 0."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.context import Clock
from depthcli.core.errors import InputError
from depthcli.core.frames import Image, StereoPair
from depthcli.core.maps import DisparityMap, Floats, Status
from depthcli.methods.stereo.stages import quick_stages
from depthcli.methods.stereo.volume import StereoResult

MAX_DISPARITY = 16383
"""Largest disparity that can be searched, pixels; 14 bits, since no method can match wider images."""

_SMALL, _LARGER = 5_000, 20_000  # pixels of the two sizes at which a pair is matched to find its range
_WINDOWS = 7, 5  # sides of the census window at these sizes, pixels
_MIN_SHIFT, _MAX_SHIFT = -0.5, 0.75  # disparities searched at the smaller size, shares of the width
_TAIL = 0.002  # share of the matches at the smaller size to ignore at either end: some are incorrect
_MIN_MATCHES, _MIN_MATCHED = 50, 0.1  # pixels, and their share of the larger size; in noise 4 % match by chance
# A disparity (pixels of the larger size) counts if it has this share of the matches. Steps of more than _GAP separate
# groups. A group with at least _LEAST_GROUP of the matches is an object, a smaller one is false matches.
_LEAST_SHARE, _GAP, _LEAST_GROUP = 0.0005, 3, 0.01
# The nearest objects are not matched in both views at the left border, and are lost in small images if they are thin.
# Shares of the range found: at most 0.3 % of the ground truth is beyond, on Middlebury 2001 to 2014 and KITTI.
_MARGIN_ABOVE, _MARGIN_BELOW = 0.25, 0.1
_MIN_MARGIN = 2  # pixels of the larger size
_LEAST_BEHIND = 0.05  # below this share of matches, negative disparities are false, e.g. in the sky of parallel cameras


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
        """Return the pair shifted so that its smallest disparity is 0, or the pair itself if it is 0 already.

        If ``min_disparity`` is positive, columns are cut off, because nothing in the left ones can be matched.
        If it is negative, columns are repeated. Every other match keeps its place, inside or outside the right image.
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

        Pixels without a partner in the right image, whatever their disparity, are occluded. They take the values next
        to them if the map has no holes, and otherwise stay empty.
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
            pictures={name: self._picture_of_pair(part) for name, part in result.pictures.items()},
        )

    def _picture_of_pair(self, picture: NDArray[Any]) -> NDArray[Any]:
        """Return a picture in the pair's pixels; the values of a float32 one are disparities, which are shifted."""
        there = self._to_pair(picture)
        return there + np.float32(self.min_disparity) if picture.dtype == np.float32 else there

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


class MatchedRange(NamedTuple):
    """Disparities of ``n_matches`` pixels of a small image, with a margin: ``low`` .. ``top``, inclusive, pixels."""

    low: int
    top: int
    n_matches: int

    @property
    def suggested(self) -> SearchRange:
        """Return the range, widened to include disparities 0 and 1."""
        return SearchRange(min(self.low, 0), max(self.top, 1))

    def union(self, other: MatchedRange) -> MatchedRange:
        """Return the smallest range that contains both."""
        return MatchedRange(min(self.low, other.low), max(self.top, other.top), self.n_matches + other.n_matches)


class _SmallMatches(NamedTuple):
    """Disparities of the pixels that match at two small sizes of a pair, in pixels of the pair."""

    low: float
    top: float
    unit: float  # one pixel of the larger size
    n_matches: int
    n_behind: int  # matches with a disparity below ``-unit``


def matched_range(pair: StereoPair) -> MatchedRange:
    """Return the range of the disparities that a pair has at two small sizes, with a margin.

    Raise InputError if too few pixels match, or a view is flat.
    """
    found = _small_matches(pair)
    shares = _MARGIN_BELOW, _MARGIN_ABOVE
    below, above = (max(_MIN_MARGIN * found.unit, share * (found.top - found.low)) for share in shares)
    low, top = found.low - below, found.top + above
    if found.n_behind < _LEAST_BEHIND * found.n_matches:
        low = max(low, 0)
    return MatchedRange(int(np.floor(low)), int(np.ceil(top)), found.n_matches)


def matched_beyond(pair: StereoPair, search: SearchRange) -> int | None:
    """Return the largest disparity that a pair has at two small sizes if the range ends below it; None otherwise."""
    try:
        found = _small_matches(pair)
    except InputError:  # too few pixels match
        return None
    return round(found.top) if found.top > search.max_disparity + found.unit else None


def _small_matches(pair: StereoPair) -> _SmallMatches:
    """Match a pair at two small sizes. Raise InputError if too few pixels match, or a view is flat.

    The smaller size is matched over nearly all disparities, the larger one over the disparities found there. A pixel
    counts if both sizes and both views agree on it.
    """
    for view, image in zip(("left", "right"), pair.grey8, strict=True):
        if image.min() == image.max():
            raise InputError(f"every pixel of the {view} image is {image.max()}: there is nothing to match")
    width = pair.shape[1]
    views = _reduced(pair.grey8, _LARGER)
    fewer = _reduced(views, _SMALL)
    unit, scale = (width / each[0].shape[1] for each in (views, fewer))  # pixels of the pair
    low, top = _MIN_SHIFT * width, _MAX_SHIFT * width
    small = _matched(fewer, low / scale, top / scale, _WINDOWS[0]) * np.float32(scale)
    known = small[~np.isnan(small)]
    ends = np.quantile(known, (_TAIL, 1 - _TAIL)) if known.size else (0.0, 0.0)
    low, top = max(ends[0] - 4 * scale, low), min(ends[1] + 4 * scale, top)
    larger = _matched(views, low / unit, top / unit, _WINDOWS[1]) * np.float32(unit)
    enlarged = cv2.resize(small, (larger.shape[1], larger.shape[0]), interpolation=cv2.INTER_NEAREST)
    agreed = larger[np.abs(larger - enlarged) <= scale]
    if len(agreed) < max(_MIN_MATCHES, _MIN_MATCHED * larger.size):
        raise InputError(
            f"only {len(agreed)} of {larger.size} pixels of the reduced images match, too few to find the search "
            "range; give max_disparity (views swapped, or not rectified? see depthcli rectify)"
        )
    values, counts = np.unique(np.round(agreed / unit).astype(np.int32), return_counts=True)
    often = counts >= max(2, _LEAST_SHARE * len(agreed))
    values, counts = values[often], counts[often]
    group = np.cumsum(np.diff(values, prepend=values[:1]) > _GAP)
    kept = values[(np.bincount(group, counts) >= _LEAST_GROUP * len(agreed))[group]] * unit
    return _SmallMatches(kept[0], kept[-1], unit, len(agreed), int(np.count_nonzero(agreed < -unit)))


def _reduced(views: Sequence[Image], n_pixels: int) -> tuple[Image, Image]:
    """Return both views with at most ``n_pixels``."""
    height, width = views[0].shape
    shrink = min(1.0, (n_pixels / (height * width)) ** 0.5)
    size = max(1, round(width * shrink)), max(1, round(height * shrink))
    left, right = (cast(Image, cv2.resize(image, size, interpolation=cv2.INTER_AREA)) for image in views)
    return left, right


def _matched(views: tuple[Image, Image], low: float, top: float, window: int) -> Floats:
    """Return the disparities of a small pair from ``low`` to ``top``, (H, W) float32, NaN where the views disagree."""
    width, search = views[0].shape[1], SearchRange(int(np.floor(low)), int(np.ceil(top)))
    pair, stages = search.shift(StereoPair(*views)), quick_stages(window=window, paths=4)
    found = search.restore(stages.compute(pair, search.shifted_max_disparity, Clock()), width).disparity
    return np.where(found.measured, found.values, np.float32(np.nan))


def complete_range(
    min_disparity: int | str, max_disparity: int | str | None, pair: StereoPair, known: MatchedRange | None = None
) -> tuple[SearchRange, dict[str, int]]:
    """Replace ends that are "auto" by the reduced pair's, and a missing upper end by the range that it suggests.

    ``known`` is the range of the pair's sequence; None: use the pair's own range. Return the range and, if an end is
    "auto", columns of the report: number of matches and their range. Raise InputError if the range is empty, or if
    too few pixels match.
    """
    columns = {}
    if max_disparity is None or "auto" in (min_disparity, max_disparity):
        found = known or matched_range(pair)
        low, top = found.low, found.top
        if max_disparity is None:
            low, max_disparity = found.suggested.min_disparity, found.suggested.max_disparity
        else:
            columns = {"range_matches": found.n_matches, "range_low": low, "range_top": top}
        min_disparity = low if min_disparity == "auto" else min_disparity
        max_disparity = top if max_disparity == "auto" else max_disparity
        if columns and top <= int(min_disparity):
            raise InputError(
                f"the images match at disparities from {low} to {top}, but {min_disparity} is the smallest that is "
                "searched: check that the views are not swapped; otherwise lower min_disparity"
            )
    search = SearchRange(int(min_disparity), int(max_disparity))
    if search.shifted_max_disparity <= 0:
        raise InputError(f"disparities from {min_disparity} to {max_disparity} are to be searched, which are none")
    return search, columns
