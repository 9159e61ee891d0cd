"""Which disparities to search, and how a range that does not begin at 0 is brought to one that does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.keypoints.surf import Surf
from depthcli.core.errors import InputError
from depthcli.core.frames import Image, StereoPair
from depthcli.core.maps import DisparityMap, Status
from depthcli.methods.stereo.keypoint_matching import consistent, match_rectified
from depthcli.methods.stereo.volume import StereoResult

# Widths of images that are looked at for key points: more of them say nothing new about the range.
_MOST_PIXELS = 600_000
_ROWS_APART = 1.0
_NEAREST, _FARTHEST = 0.75, -0.5  # of the width: what is looked for
_TAIL = 0.005  # share of the matches at either end that is not believed
_FEWEST = 16
# The nearest and the farthest things seldom have key points; on the Middlebury scenes of 2001 to 2014 at most 0.4 % of
# the true disparities lie beyond these margins (shares of the range between the quantiles), on KITTI 1.8 %.
_ABOVE, _BELOW, _AT_LEAST = 0.3, 0.2, 4.0


@dataclass(frozen=True)
class SearchRange:
    """Disparities ``low`` .. ``top``, both inclusive, pixels."""

    low: int
    top: int

    @property
    def last(self) -> int:
        """Largest disparity of the shifted pair, whose smallest is 0."""
        return self.top - self.low

    def shift(self, pair: StereoPair) -> StereoPair:
        """The pair whose disparities are smaller by ``low``; a range that begins at 0 leaves it as it is.

        Columns are cut off where ``low`` is positive, since nothing to the left of them can be matched, and repeated
        where it is negative: every other match keeps its place, inside or outside the right image.
        """
        if self.low == 0:
            return pair
        width = pair.shape[1]
        if self.low >= width:
            raise InputError(f"the smallest disparity is {self.low}, but the images are {width} pixels wide")
        if self.low > 0:
            left, right = pair.left[:, self.low :].copy(), pair.right[:, : width - self.low].copy()
        else:
            left, right = _widened(pair.left, -self.low, 0), _widened(pair.right, 0, -self.low)
        return StereoPair(left, right, pair.bits)

    def restore(self, result: StereoResult, width: int) -> StereoResult:
        """The result of the shifted pair, in the pixels and disparities of the pair, which is ``width`` wide.

        Pixels without a partner in the right image, whatever their disparity, are occluded; they are filled by
        the values next to them where the map has no holes, else they stay empty.
        """
        if self.low == 0:
            return result
        values, status = (self._to_pair(part) for part in (result.disparity.values, result.disparity.status))
        values = values + np.float32(self.low)
        fills = not np.isnan(result.disparity.values).any()
        if self.low > 0:
            outside = np.broadcast_to(np.arange(width) < self.low, values.shape)
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
        """(H, W', ...) of the shifted pair at the pair's width; new columns repeat the first one."""
        if self.low < 0:
            return np.ascontiguousarray(values[:, -self.low :])
        return np.pad(values, ((0, 0), (self.low, 0), *(((0, 0),) * (values.ndim - 2))), mode="edge")

    def share_at_ends(self, disparity: DisparityMap) -> tuple[float, float]:
        """Shares of the measured pixels within a pixel of the range's lower and upper end."""
        measured = disparity.values[disparity.measured]
        if measured.size == 0:
            return 0.0, 0.0
        return float(np.mean(measured < self.low + 1)), float(np.mean(measured > self.top - 1))


def range_of_key_points(pair: StereoPair) -> tuple[SearchRange, int]:
    """The range that matched key points suggest, with a margin, and how many matches say so.

    Raises
    ------
    InputError
        Too few key points match.
    """
    height, width = pair.shape
    shrink = min(1.0, (_MOST_PIXELS / (height * width)) ** 0.5)
    size = (max(1, round(width * shrink)), max(1, round(height * shrink)))
    views = [_smaller(image, size) for image in pair.grey8]
    detect: Callable[[NDArray[np.uint8]], Any] = Surf(threshold=1e-6)
    found = consistent(
        match_rectified(
            detect(views[0]), detect(views[1]), _NEAREST * size[0], _ROWS_APART, min_disparity=_FARTHEST * size[0]
        )
    )
    if len(found) < _FEWEST:
        raise InputError(
            f"only {len(found)} key points match, too few to find the search range; say it with --max-disparity PIXELS "
            "(views swapped, or not rectified?)"
        )
    low, high = np.quantile(found.disparity.astype(np.float64), (_TAIL, 1 - _TAIL)) * (width / size[0])
    below, above = (max(_AT_LEAST, share * (high - low)) for share in (_BELOW, _ABOVE))
    return SearchRange(int(np.floor(low - below)), int(np.ceil(high + above))), len(found)


def suggested_range(pair: StereoPair) -> SearchRange:
    """Return the range of key points, widened to disparity 0 and 1; InputError where too few match."""
    found, _ = range_of_key_points(pair)
    return SearchRange(min(found.low, 0), max(found.top, 1))


def complete_range(low: int | str, top: int | str | None, pair: StereoPair) -> tuple[SearchRange, dict[str, int]]:
    """Replace ends that are "auto" by those of key points, and a missing upper end by the suggested range.

    Returns
    -------
    search : the range
    columns : what key points say, for the report, where an end is "auto"

    Raises
    ------
    InputError
        The range is empty, or too few key points match.
    """
    if top is None:
        suggested = suggested_range(pair)
        low, top = (low if low not in (0, "auto") else suggested.low), suggested.top
    columns = {}
    if "auto" in (low, top):
        found, n_matches = range_of_key_points(pair)
        columns = {"range_matches": n_matches, "range_low": found.low, "range_top": found.top}
        low, top = (found.low if low == "auto" else low), (found.top if top == "auto" else top)
    assert isinstance(low, int) and isinstance(top, int)
    if top <= low:
        raise InputError(f"disparities from {low} to {top} are to be searched, which are none")
    return SearchRange(low, top), columns


def _smaller(image: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.uint8]:
    if image.shape[::-1] == size:
        return image
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def _widened(image: Image, before: int, behind: int) -> Image:
    return cast(Image, cv2.copyMakeBorder(image, 0, 0, before, behind, cv2.BORDER_REPLICATE))
