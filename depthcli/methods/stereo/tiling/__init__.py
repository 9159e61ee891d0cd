"""Large pairs, matched in tiles, coarse to fine: the map at half the size limits the disparities to search.

After Rothermel, Wenzel, Fritsch and Haala, "SURE: photogrammetric surface reconstruction from imagery", 2012: the pair
is matched at the smallest size first. The result determines which disparities a tile of the next size searches, and
which of them are likely. It also fills pixels on which the two views do not agree. Single rows matched over the whole
range keep structures that are too thin for the smaller sizes.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.context import Clock, Context
from depthcli.core.frames import StereoPair
from depthcli.core.maps import DisparityMap, Floats, Status
from depthcli.kernels.winners import left_right_difference, winners
from depthcli.methods.stereo.cost._fill import hamming_volume
from depthcli.methods.stereo.cost.census import census_transform
from depthcli.methods.stereo.refinement.background_fill import BackgroundFill
from depthcli.methods.stereo.refinement.left_right_check import LeftRightCheck
from depthcli.methods.stereo.refinement.speckle_filter import SpeckleFilter
from depthcli.methods.stereo.stages import CostStages, PairMatcher, quick_stages
from depthcli.methods.stereo.tiling.plan import BIN, BLOCK, PROCESS_BYTES, Candidates, Memory
from depthcli.methods.stereo.tiling.tile_by_tile import Prior, match_by_costs, match_by_patches, refined_map
from depthcli.methods.stereo.volume import StereoResult

# Set by hand so that the maps of large pairs are near the maps of whole pairs (docs/figures.md, large images).
_MIN_DISPARITIES = 256  # smaller ranges are searched whole
_MIN_SIDE = 128  # pixels; smaller images are not halved
_ISLAND_SIZE = 20  # pixels that must be connected to be a candidate at half the size
_CANDIDATE_MARGIN = 6  # candidates around the disparities found at half the size, pixels of that size
_LIKELY_MARGIN = 4  # likely disparities around them, pixels of the full size
_UNSURE_SHARE = 0.25  # of a block's pixels without agreement; above it, surrounding disparities are candidates, too
_ROW_STEP, _ROW_WINDOW, _ROW_CELLS = 4, (7, 7), 1 << 25  # rows matched by themselves; their census; cells at a time
_ROW_ISLAND_SIZE = 10  # pixels of these rows that must be connected
_FAR_AWAY = np.float32(1e6)  # pixels, beyond every range: no thin structure
# The stages at the smaller sizes for methods without cost stages.
_COARSE_STAGES = quick_stages(SpeckleFilter(size=50), BackgroundFill())


def match_in_tiles(
    matcher: PairMatcher, pair: StereoPair, max_disparity: int, memory: int, context: Context | None = None
) -> StereoResult:
    """Match a pair over disparities 0 .. ``max_disparity`` inclusive, in a process that takes at most ``memory`` bytes.

    Methods with ``tile_stages`` compute costs tile by tile; the right view's map, and the steps that need only maps,
    cover the whole image. Any other method matches every tile separately, over one range from its smallest to its
    largest candidate, without pictures and tables. ``figures`` has ``tiles``, their number, ``levels``, the number of
    sizes that were matched, and ``exact``, which is 1 if the map is the same as the whole pair's.

    Raise InputError if not even the smallest tiles fit.
    """
    clock = Clock()
    prepared, matcher = matcher.prepared(pair, max_disparity, context, clock)
    added = 0 if prepared is pair else prepared.right.nbytes + pair.shape[0] * pair.shape[1]
    available = Memory(memory, PROCESS_BYTES + added)
    stages = matcher.tile_stages()
    exact = stages is not None and stages.halo() is not None
    prior = None if exact else coarse_prior(stages or _COARSE_STAGES, prepared, max_disparity, available, clock)
    candidates = Candidates.everywhere(pair.shape, max_disparity) if prior is None else prior.candidates
    if stages is None:
        result = match_by_patches(matcher, prepared, candidates, available, context, clock)
    else:
        result, _ = match_by_costs(stages, prepared, candidates, prior, available, clock)
    result.figures |= {"levels": 1.0 if prior is None else float(prior.levels), "exact": float(exact)}
    return result


def coarse_prior(
    stages: CostStages, pair: StereoPair, max_disparity: int, available: Memory, clock: Clock
) -> Prior | None:
    """Match ``pair`` at half its size, itself coarse to fine, and return the disparities that are likely at full size.

    Return None if the range is narrow enough, or the image small enough, to be searched whole.
    """
    if max_disparity + 1 < _MIN_DISPARITIES or min(pair.shape) < _MIN_SIDE:
        return None
    clock.start("coarse")
    half, half_range, available = halved(pair), -(-max_disparity // 2), available.beside(pair)
    prior = coarse_prior(stages, half, half_range, available, clock)
    candidates = Candidates.everywhere(half.shape, half_range) if prior is None else prior.candidates
    result, found = match_by_costs(stages, half, candidates, prior, available, Clock())
    islands = refined_map((LeftRightCheck(), SpeckleFilter(size=_ISLAND_SIZE)), found, half, half_range)
    thin = thin_structures(pair, max_disparity)
    candidates = _candidates(result.disparity, islands.values, thin, pair.shape, max_disparity)
    low, high, thin_ends = _likely(result.disparity, islands.values, thin, max_disparity)
    levels = 2 if prior is None else 1 + prior.levels
    return Prior(result.disparity.values, candidates, low, high, thin_ends, levels)


def _candidates(
    half: DisparityMap, islands: Floats, thin_rows: Floats, shape: tuple[int, int], max_disparity: int
) -> Candidates:
    """Return which disparities blocks of an image of (H, W) ``shape`` may have, from its map at half the size.

    At half the size, thin structures may be removed as speckles, filled over, or too thin to match. So the ``islands``
    that both views agree on, and the rows of :func:`thin_structures`, stay candidates. If many pixels of a block have
    no agreement, all disparities around are candidates.
    """
    side = BLOCK // 2
    blocks = tuple(-(-length // BLOCK) for length in shape)
    bins = np.zeros((*blocks, max_disparity // BIN + 1), np.bool_)
    rows, columns = (np.arange(length)[:, None] // side for length in islands.shape)
    for values in (half.values, islands):
        valid = ~np.isnan(values)
        y, x = (np.broadcast_to(part, islands.shape)[valid] for part in (rows, columns.T))
        for offset in (-_CANDIDATE_MARGIN, 0, 1 + _CANDIDATE_MARGIN):
            bins[y, x, np.clip(2 * values[valid] + offset, 0, max_disparity).astype(np.int32) // BIN] = True
    y, x = np.nonzero(~np.isnan(thin_rows))
    for offset in (-1, 1):
        values = np.clip(thin_rows[y, x] + offset, 0, max_disparity)
        bins[y * _ROW_STEP // BLOCK, x // BLOCK, values.astype(np.int32) // BIN] = True
    unsure = (half.status & Status.MISMATCH) != 0
    frame = [(0, count * side - length) for count, length in zip(blocks, islands.shape, strict=True)]
    share = np.pad(unsure, frame).reshape(blocks[0], side, blocks[1], side).mean(axis=(1, 3))
    around = cv2.dilate(bins.astype(np.uint8), np.ones((5, 5), np.uint8)).reshape(bins.shape) > 0
    bins |= around & (share > _UNSURE_SHARE)[:, :, None]
    bins[~bins.any(axis=2)] = True  # nothing was matched there at all
    return Candidates(bins, shape, max_disparity)


def _likely(
    half: DisparityMap, islands: Floats, thin_rows: Floats, max_disparity: int
) -> tuple[NDArray[np.int16], NDArray[np.int16], Floats]:
    """Return ``low``, ``high`` and ``thin`` of a :class:`Prior`, from the disparities around at half the size."""
    y, x = np.nonzero(~np.isnan(thin_rows))
    thin = np.full(islands.shape, np.nan, np.float32)
    thin[y * _ROW_STEP // 2, x // 2] = thin_rows[y, x] / 2
    unsure = (half.status & Status.MISMATCH) != 0
    ends, thin_ends = [], []
    for sign, extreme, of, nothing in ((-1, cv2.erode, np.fmin, max_disparity), (1, cv2.dilate, np.fmax, 0)):
        end = np.nan_to_num(of(of(half.values, islands), thin), nan=nothing)
        near, far = (extreme(end, np.ones((size, size), np.uint8)) for size in (5, 17))
        ends.append(2 * np.where(unsure, far, near) + sign * _LIKELY_MARGIN)
        known = np.where(np.isnan(thin), -sign * _FAR_AWAY, thin)
        thin_ends.append(2 * extreme(known, np.ones((5, 5), np.uint8)) + np.float32(sign * _LIKELY_MARGIN))
    return ends[0].astype(np.int16), (ends[1] + 1).astype(np.int16), np.stack(thin_ends)


def thin_structures(pair: StereoPair, max_disparity: int) -> Floats:
    """Match every fourth row by itself over the whole range, for structures too thin for smaller images.

    Return (ceil(H / 4), W) float32: winners of the Hamming distance of 7 x 7 census that both views agree on and that
    are connected; NaN otherwise.
    """
    height, width = pair.shape
    disparity = np.full((-(-height // _ROW_STEP), width), np.nan, np.float32)
    rows_at_once = max(1, _ROW_CELLS // (width * (max_disparity + 1)))
    strip = _ROW_STEP * rows_at_once
    radius = _ROW_WINDOW[1] // 2
    costs = np.empty((min(rows_at_once, disparity.shape[0]), width, max_disparity + 1), np.uint8)
    for y in range(0, height, strip):
        rows = slice(max(0, y - radius), min(height, y + strip + radius))
        part = StereoPair(pair.left[rows], pair.right[rows], pair.bits)
        features_left, features_right = (
            np.ascontiguousarray(census_transform(image, _ROW_WINDOW)[y - rows.start :][:strip:_ROW_STEP])
            for image in part.grey
        )
        n_rows = features_left.shape[0]
        hamming_volume(features_left, features_right, costs[:n_rows])
        left, right = winners(costs[:n_rows])
        agreed = (left_right_difference(left, right) <= 1) & (features_left != 0)  # a flat window has no information
        disparity[y // _ROW_STEP :][:n_rows] = np.where(agreed, left, np.float32(np.nan))
    # Speckles are removed on int16: as many steps per pixel as fit.
    steps = max(1, min(16, 32767 // (max_disparity + 1)))
    fixed = np.where(np.isnan(disparity), -steps * 4, np.nan_to_num(disparity) * steps).astype(np.int16)
    cv2.filterSpeckles(fixed, -steps * 4, _ROW_ISLAND_SIZE, steps)
    return np.where(fixed < 0, np.float32(np.nan), disparity).astype(np.float32)


def halved(pair: StereoPair) -> StereoPair:
    """Return the pair at half its size, an odd side rounded up: means of 2 x 2 pixels."""

    def half(image: Any) -> Any:
        height, width = image.shape[:2]
        even = cv2.copyMakeBorder(image, 0, height % 2, 0, width % 2, cv2.BORDER_REPLICATE)
        return cv2.resize(even, (even.shape[1] // 2, even.shape[0] // 2), interpolation=cv2.INTER_AREA)

    trust = None if pair.light_trust is None else half(pair.light_trust)
    return StereoPair(half(pair.left), half(pair.right), pair.bits, trust)
