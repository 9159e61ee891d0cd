"""What the image of half the size, and a glance at single rows, say about a pair before it is matched."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.frames import Image, StereoPair
from depthcli.core.maps import DisparityMap, Status
from depthcli.kernels.winners import left_right_difference, winners
from depthcli.methods.stereo.cost._fill import empty_volume, hamming_volume
from depthcli.methods.stereo.cost.census import census_transform
from depthcli.methods.stereo.tiles import BIN, BLOCK, Candidates

_MARGIN = 6  # candidates beside what was found at half the size, pixels
_NEAR = 4  # the likely ones of them
_EVERY, _GLANCE, _STRIP = 4, (7, 7), 1 << 25  # rows that are looked at by themselves, their census, cells at a time
_TOGETHER = 10  # pixels of these rows that must belong together
_NOWHERE = 1e6  # pixels


@dataclass(frozen=True)
class Prior:
    """What the pair at half its size says.

    Attributes
    ----------
    values : (ceil(H / 2), ceil(W / 2)) float32, its map
    candidates : by block of the pair itself
    low, high : of the shape of ``values``, int16, the likely disparities at the full size
    glimpsed : (2, ...) float32, least and largest of the glimpses around at the full size; where none are, the
        least is larger than any disparity
    levels : number of sizes matched, that of the pair counted
    """

    values: NDArray[np.float32]
    candidates: Candidates
    low: NDArray[np.int16]
    high: NDArray[np.int16]
    glimpsed: NDArray[np.float32]
    levels: int

    @classmethod
    def of(
        cls,
        found: DisparityMap,
        seen: NDArray[np.float32],
        glimpses: NDArray[np.float32],
        shape: tuple[int, int],
        top: int,
        levels: int,
    ) -> Prior:
        """Of what was found, or NaN.

        Thin things may have been removed as speckles at half the size, filled over, or too thin to be seen: islands
        and glimpses stay candidates. Where the views did not agree, whatever was found around may be there.

        Parameters
        ----------
        found : the finished map at half the size
        seen : of its shape, all that both views agreed on, also islands
        glimpses : (ceil(H / 4), W), of :func:`glimpses_of`
        """
        side = BLOCK // 2
        blocks = tuple(-(-length // BLOCK) for length in shape)
        bins = np.zeros((*blocks, top // BIN + 1), np.bool_)
        rows, columns = (np.arange(length)[:, None] // side for length in seen.shape)
        for values in (found.values, seen):
            valid = ~np.isnan(values)
            y, x = (np.broadcast_to(part, seen.shape)[valid] for part in (rows, columns.T))
            for offset in (-_MARGIN, 0, 1 + _MARGIN):
                bins[y, x, np.clip(2 * values[valid] + offset, 0, top).astype(np.int32) // BIN] = True
        y, x = np.nonzero(~np.isnan(glimpses))
        thin = np.full(seen.shape, np.nan, np.float32)
        thin[y * _EVERY // 2, x // 2] = glimpses[y, x] / 2
        for offset in (-1, 1):
            values = np.clip(glimpses[y, x] + offset, 0, top)
            bins[y * _EVERY // BLOCK, x // BLOCK, values.astype(np.int32) // BIN] = True
        unsure = (found.status & Status.MISMATCH) != 0
        frame = [(0, count * side - length) for count, length in zip(blocks, seen.shape, strict=True)]
        share = np.pad(unsure, frame).reshape(blocks[0], side, blocks[1], side).mean(axis=(1, 3))
        around = cv2.dilate(bins.astype(np.uint8), np.ones((5, 5), np.uint8)).reshape(bins.shape) > 0
        bins |= around & (share > 0.25)[:, :, None]
        bins[~bins.any(axis=2)] = True  # nothing was found there at all
        ends, glimpsed = [], []
        for extreme, of, nothing in ((cv2.erode, np.fmin, top), (cv2.dilate, np.fmax, 0)):
            end = np.nan_to_num(of(of(found.values, seen), thin), nan=nothing)
            near, far = (extreme(end, np.ones((size, size), np.uint8)) for size in (5, 17))
            ends.append(2 * np.where(unsure, far, near))
            far_away, offset = (_NOWHERE, -_NEAR) if nothing else (-_NOWHERE, _NEAR)
            known = np.where(np.isnan(thin), np.float32(far_away), thin)
            glimpsed.append(2 * extreme(known, np.ones((5, 5), np.uint8)) + np.float32(offset))
        low, high = (ends[0] - _NEAR).astype(np.int16), (ends[1] + 1 + _NEAR).astype(np.int16)
        return cls(found.values, Candidates(bins, shape, top), low, high, np.stack(glimpsed), levels)


def glimpses_of(pair: StereoPair, top: int) -> NDArray[np.float32]:
    """What every fourth row sees over the whole range by itself: a look for things too thin for smaller images.

    Returns
    -------
    (ceil(H / 4), W) float32
        Winners of the Hamming distance of 7 x 7 census that both views agree on and that belong together; else NaN.
    """
    height, width = pair.shape
    found = np.full((-(-height // _EVERY), width), np.nan, np.float32)
    strip = _EVERY * max(1, _STRIP // (width * (top + 1)))
    radius = _GLANCE[1] // 2
    for y in range(0, height, strip):
        rows = slice(max(0, y - radius), min(height, y + strip + radius))
        part = StereoPair(pair.left[rows], pair.right[rows], pair.bits)
        one, other = (
            np.ascontiguousarray(census_transform(image, _GLANCE)[y - rows.start :][:strip:_EVERY])
            for image in part.grey
        )
        costs = empty_volume((one.shape[0], width), top + 1)
        hamming_volume(one, other, costs)
        left, right = winners(costs)
        agreed = (left_right_difference(left, right) <= 1) & (one != 0)  # a flat window says nothing
        found[y // _EVERY :][: one.shape[0]] = np.where(agreed, left, np.float32(np.nan))
    steps = max(1, min(16, 32767 // (top + 1)))
    fixed = np.where(np.isnan(found), -steps * 4, np.nan_to_num(found) * steps).astype(np.int16)
    cv2.filterSpeckles(fixed, -steps * 4, _TOGETHER, steps)
    return np.where(fixed < 0, np.float32(np.nan), found).astype(np.float32)


def halved(pair: StereoPair) -> StereoPair:
    """The pair at half its size, an odd side rounded up: means of 2 x 2 pixels."""
    trust = None if pair.light_trust is None else cast(NDArray[np.uint8], _half(pair.light_trust))
    return StereoPair(_half(pair.left), _half(pair.right), pair.bits, trust)


def _half(image: Image) -> Image:
    height, width = image.shape[:2]
    even = cv2.copyMakeBorder(image, 0, height % 2, 0, width % 2, cv2.BORDER_REPLICATE)
    return cast(Image, cv2.resize(even, (even.shape[1] // 2, even.shape[0] // 2), interpolation=cv2.INTER_AREA))
