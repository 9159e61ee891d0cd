"""Evidence about every pixel of a disparity map, from images, the map itself and other maps: costs, then planes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core import memory
from depthcli.core.context import Clock, Context
from depthcli.core.frames import StereoPair
from depthcli.core.maps import DisparityMap
from depthcli.kernels.indices import indices
from depthcli.kernels.jit import empty, jit, run_bands
from depthcli.kernels.winners import winners
from depthcli.methods.fusion.map_costs import (
    Views,
    cost_between,
    deviation,
    disagreements,
    image_planes,
    match_in_right,
    nearest_matches,
    warped_right,
)
from depthcli.methods.fusion.votes import BLOCK_DEPTH, NO_VOTE
from depthcli.methods.stereo.adjustment import adjusted
from depthcli.methods.stereo.cost.census import Census
from depthcli.methods.stereo.optimization.scanline import Scanline
from depthcli.methods.stereo.refinement.background_fill import BackgroundFill
from depthcli.methods.stereo.refinement.left_right_check import LeftRightCheck
from depthcli.methods.stereo.refinement.median import Median
from depthcli.methods.stereo.refinement.speckle_filter import SpeckleFilter
from depthcli.methods.stereo.refinement.subpixel import Subpixel
from depthcli.methods.stereo.refinement.surface_fill import SurfaceFill
from depthcli.methods.stereo.stages import refined
from depthcli.methods.stereo.volume import CostVolume, RefinementContext

# The steps of the preset stereo fast; networks are trained with them.
_COST = Census(window=(7, 7))
_OPTIMIZATION = Scanline(p1=25, p2=120, paths=8, edge_threshold=15, edge_divisor=6)
_REFINEMENT = (
    LeftRightCheck(),
    SpeckleFilter(size=50),
    Subpixel(),
    SurfaceFill(rows=4, reach=20),
    BackgroundFill(),
    Median(window=5),
)


@dataclass(frozen=True)
class Evidence(Views):
    """Costs of a pair, the evidence for its maps."""

    pair: StereoPair  # the images, adjusted: noise, rows, brightness
    volume: CostVolume  # (H, W, D) matching costs
    optimized: CostVolume  # (H, W, D) costs with smoothness
    # (H, W) uint16, disparities of the smallest optimized costs in each view
    left: NDArray[np.uint16]
    right: NDArray[np.uint16]
    reference: DisparityMap  # the map of the preset stereo fast, from these costs

    @classmethod
    def of(cls, pair: StereoPair, max_disparity: int, clock: Clock, context: Context | None = None) -> Evidence:
        """Compute the costs of disparities 0 .. ``max_disparity``; ``clock`` records the stages."""
        pair = adjusted(pair, max_disparity, ("noise", "rows", "light"), context, clock)
        clock.start("cost")
        volume = _COST(pair, max_disparity + 1)
        clock.start("optimization")
        optimized = _OPTIMIZATION(volume, pair)
        left, right = winners(optimized.costs)
        clock.start("refinement")
        raw = DisparityMap(left.astype(np.float32), np.zeros(pair.shape, np.uint8))
        reference = refined(raw, _REFINEMENT, RefinementContext(pair, optimized, right))
        return cls(pair, volume, optimized, left, right, reference)


SHAPE = (
    *(f"deviation_of_map_{side}" for side in (5, 11, 21, 41)),
    *("above_mean_11", "above_mean_25", "above_median_5", "above_median_21", "edge_distance"),
    *("step_right", "step_left", "step_around", "relative"),
)
"""Planes of a map's shape.

Standard deviations of windows, differences from means and medians of windows, distance to the next step, steps to the
largest disparity on the right and on the left and to the smallest one around, share of the disparity range.
"""
IMAGE = ("deviation_5", "deviation_13", "deviation_31", "gradient", "border_distance")
ONE_VIEW = (*SHAPE, *IMAGE)
"""Planes that need a map and the left image only."""
AVERAGED = (
    *("cost", "far_cost", "contradiction", "hidden", "excess", "winner_difference", "other_winner"),
    *("right_difference", "missing", "color_difference", "margin"),
    *("reference_difference", "other_reference", "reference_filled"),
)
"""Planes that are averaged over pixels of similar color, in a narrow and in a wide support.

| plane | definition |
|---|---|
| ``cost``, ``far_cost`` | matching cost along the map, divided by 30 or 12 (of 48 bits), at most 1 |
| ``contradiction``, ``hidden`` | in front of the right view's surface at the match; behind it, or outside |
| ``excess`` | log(cost / smallest cost), with smoothness |
| ``winner_difference``, ``other_winner`` | difference from the disparity of smallest cost, pixels; whether above 1 |
| ``right_difference`` | difference from the right view's disparity at the match, pixels |
| ``missing`` | whether the map has a gap |
| ``color_difference`` | largest channel difference from the match, grey levels |
| ``margin`` | log(smallest cost elsewhere / cost), with smoothness |
| ``reference_difference``, ``other_reference`` | difference from the ``stereo fast`` map, pixels; whether above 1 |
| ``reference_filled`` | whether the ``stereo fast`` map is filled there |
"""
SINGLE = (
    *("cost", "excess", "winner_difference", "right_difference", "match_column", "self_occlusion", "rank", "margin"),
    *("missing", "reference_difference", "reference_filled"),
)
"""Planes of the pixel itself: some of the planes above, with the sign of differences, and:

| plane | definition |
|---|---|
| ``match_column`` | column of the match in the right image, clipped to -20 .. 20 |
| ``self_occlusion`` | disparity by which a nearer pixel of the map covers the match, pixels |
| ``rank`` | share of the disparities with smaller costs, with smoothness |
"""
_MEAN, _OWN = indices(AVERAGED), indices(SINGLE)
_ONES = len(AVERAGED)  # place of the sum of ones, behind the sums
VIEWS = ("decorrelation", "color_difference")
PIXEL = (*IMAGE[:4], "light_trust", "min_cost", "peak", IMAGE[4])
ALONE = (*(f"{n}_narrow" for n in AVERAGED), *(f"{n}_wide" for n in AVERAGED), *SINGLE, *VIEWS, *SHAPE, *PIXEL)
OTHERS = (
    *("disagreement_narrow", "disagreement_wide", "nearest_map", "middle_map", "farthest_map", "above_middle"),
    *("cost_narrow_relative", "cost_wide_relative", "excess_narrow_relative", "decorrelation_relative"),
    *("deviation_of_map_11_relative", "maps"),
)
"""Planes of a map's relation to other maps.

Share of maps that disagree, distances to the nearest, the median and the farthest map, pixels above the median, planes
relative to the smallest among the maps, and log2 of the number of maps.
"""
INPUTS = (*ALONE, *OTHERS)
"""Inputs of the network, in order."""

Planes = dict[str, NDArray[np.float32]]
"""Planes by name, (H, W) each."""


def shape_planes(values: NDArray[np.float32], max_disparity: int, plane: Planes) -> None:
    """Write the planes ``SHAPE`` of a map without gaps."""
    for side in (5, 11, 21, 41):
        deviation(values, side, 10, plane[f"deviation_of_map_{side}"])
    top = np.float32(max(max_disparity, 1))
    coarse = cv2.medianBlur((values * (255 / top)).astype(np.uint8), 21).astype(np.float32) * (top / 255)
    middles = {f"mean_{side}": cv2.blur(values, (side, side)) for side in (11, 25)}
    for name, middle in {**middles, "median_5": cv2.medianBlur(values, 5), "median_21": coarse}.items():
        above, most = plane[f"above_{name}"], 8 if middle is coarse else 6
        np.clip(values - middle, -most, most, out=above)
    edges = np.zeros(values.shape, np.uint8)
    edges[:, 1:] |= np.abs(np.diff(values, axis=1)) > 1
    edges[1:] |= np.abs(np.diff(values, axis=0)) > 1
    far = cv2.distanceTransform(1 - edges, cv2.DIST_L2, 3) if edges.any() else np.full(values.shape, 30, np.float32)
    np.minimum(far, 30, out=plane["edge_distance"])
    line = np.ones((1, 15), np.uint8)
    np.subtract(cv2.dilate(values, line, anchor=(0, 0)), values, out=plane["step_right"])
    np.subtract(cv2.dilate(values, line, anchor=(14, 0)), values, out=plane["step_left"])
    np.subtract(values, cv2.erode(values, np.ones((9, 9), np.uint8)), out=plane["step_around"])
    for name in ("step_right", "step_left", "step_around"):
        np.minimum(plane[name], 12, out=plane[name])
    np.divide(values, top, out=plane["relative"])


def _left_planes(grey: NDArray[np.float32], plane: Planes) -> None:
    """Write the planes ``IMAGE`` of the left image, grey levels 0 .. 255."""
    height, width = grey.shape
    image_planes(grey, (5, 13, 31), plane)
    columns, rows = np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)[:, None]
    beside, above = np.minimum(columns, width - 1 - columns), np.minimum(rows, height - 1 - rows)
    np.minimum(np.minimum(beside, above), 20, out=plane["border_distance"])


def one_view_planes(values: NDArray[np.float32], grey: NDArray[np.float32], max_disparity: int) -> NDArray[np.float32]:
    """Return the planes ``ONE_VIEW`` of a map without gaps, (len(ONE_VIEW), H, W) float32."""
    out = np.empty((len(ONE_VIEW), *values.shape), np.float32)
    plane = dict(zip(ONE_VIEW, out, strict=True))
    shape_planes(values, max_disparity, plane)
    _left_planes(grey, plane)
    return out


def pixel_planes(evidence: Evidence) -> NDArray[np.float32]:
    """Return the planes ``PIXEL``, which are the same for all maps, (len(PIXEL), H, W) float32."""
    out = np.empty((len(PIXEL), *evidence.pair.shape), np.float32)
    plane = dict(zip(PIXEL, out, strict=True))
    _left_planes(evidence.grey[0], plane)
    plane["light_trust"][:] = evidence.light_trust
    unit = np.float32(1 / evidence.optimized.scale)
    run_bands(
        _peaks, len(evidence.optimized.costs), evidence.optimized.costs, evidence.left, unit, plane["min_cost"],
        plane["peak"],
    )  # fmt: skip
    return out


def alone_planes(
    values: NDArray[np.float32], missing: NDArray[np.bool_], evidence: Evidence, shared: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return the planes ``ALONE`` of a map without gaps, (len(ALONE), H, W) float32."""
    height, width = values.shape
    out = memory.empty((len(ALONE), height, width), np.float32)
    plane = dict(zip(ALONE, out, strict=True))
    out[-len(PIXEL) :] = shared
    block = memory.empty((height, width, BLOCK_DEPTH), np.float32)
    first = 2 * len(AVERAGED)
    single = out[first : first + len(SINGLE)]
    warped = np.empty((height, width), np.float32)
    unit, optimized_unit = np.float32(1 / evidence.volume.scale), np.float32(1 / evidence.optimized.scale)
    costs = (evidence.volume.costs, evidence.optimized.costs, unit, optimized_unit, evidence.left, evidence.right)
    views = (*evidence.pair.color8, evidence.grey[1], plane["min_cost"])
    reference = (evidence.reference.values, evidence.reference.status)
    out_planes = (block, single, warped, plane["color_difference"])
    run_bands(_compare, height, values, missing.view(np.uint8), *costs, *views, *reference, *out_planes)
    for k, (support, array) in enumerate(((evidence.narrow, block.copy()), (evidence.wide, block))):
        support.sum(array)
        run_bands(_spread, height, array, out[k * len(AVERAGED) : (k + 1) * len(AVERAGED)])
    evidence.decorrelation(warped[None], plane["decorrelation"][None])
    shape_planes(values, evidence.volume.n_disparities - 1, plane)
    return out


def other_planes(
    maps: NDArray[np.float32], alone: Sequence[NDArray[np.float32]], evidence: Evidence
) -> NDArray[np.float32]:
    """Return the planes ``OTHERS`` of every map, (N, len(OTHERS), H, W) float32; all 0 if there is only one map."""
    count, height, width = maps.shape
    out = np.zeros((count, len(OTHERS), height, width), np.float32)
    if count == 1:
        return out
    index = {name: k for k, name in enumerate(OTHERS)}
    weight = np.ones(count, np.float32)
    for name, support in (("narrow", evidence.narrow), ("wide", evidence.wide)):
        out[:, index[f"disagreement_{name}"]] = support.mean(disagreements(maps, weight))
    run_bands(
        _relate,
        height,
        maps,
        *(out[:, index[name]] for name in ("nearest_map", "middle_map", "farthest_map", "above_middle")),
    )
    for name in OTHERS:
        if name.endswith("_relative"):
            compared = [planes[ALONE.index(name.removesuffix("_relative"))] for planes in alone]
            out[:, index[name]] = compared - np.minimum.reduce(compared)
    out[:, index["maps"]] = np.log2(np.float32(count))
    return out


@jit
def _peaks(begin, end, costs, winner, unit, best, peak):
    _, width, n_disparities = costs.shape
    soft = np.float32(2)
    for y in range(begin, end):
        for x in range(width):
            row, w = costs[y, x], int(winner[y, x])
            count = min(n_disparities, x + 1)
            second = np.uint16(65535)
            for d in range(max(0, w - 1)):
                second = min(second, row[d])
            for d in range(w + 2, count):
                second = min(second, row[d])
            best[y, x] = np.float32(row[w]) * unit
            peak[y, x] = min(np.float32(np.log((np.float32(second) * unit + soft) / (best[y, x] + soft))), soft)


@jit
def _compare(
    begin, end, values, missing, costs, optimized, unit, optimized_unit, left, right, image, other, grey, best,
    reference, status, block, single, warped, color,
):  # fmt: skip
    width = values.shape[1]
    n_disparities = costs.shape[2]
    half, one, zero = np.float32(0.5), np.float32(1), np.float32(0)
    far, soft = np.float32(8), np.float32(2)
    for y in range(begin, end):
        nearest = nearest_matches(values[y])
        for x in range(width):
            value = values[y, x]
            cells = block[y, x]
            cells[:] = NO_VOTE
            outside = int(value) > x
            raw = cost_between(costs[y, x], value) * unit
            row = optimized[y, x]
            here = cost_between(row, value)
            winner = np.float32(left[y, x])
            count = min(n_disparities, x + 1)
            v = int(value + half)
            bound = np.uint16(min(here, np.float32(65535)))
            lower = np.uint16(0)
            smallest = np.uint16(65535)
            for d in range(count):
                lower += np.uint16(row[d] < bound)
            for d in range(max(0, min(v - 1, count))):
                smallest = min(smallest, row[d])
            for d in range(v + 2, count):
                smallest = min(smallest, row[d])
            c_here, c_winner = here * optimized_unit, best[y, x]
            excess = min(np.float32(np.log((c_here + soft) / (c_winner + soft))), soft)
            margin = min(
                max(np.float32(np.log((np.float32(smallest) * optimized_unit + soft) / (c_here + soft))), -soft), soft
            )
            to_winner = min(abs(value - winner), far)
            match = match_in_right(x, value, right[y], nearest)
            contradiction, hidden, difference, column, covered, right_far = match
            warped[y, x], color[y, x] = warped_right(x, value, image[y], other[y], grey[y])
            empty = np.float32(missing[y, x])
            cells[_MEAN.cost] = one if outside else min(raw / np.float32(30), one)
            cells[_MEAN.far_cost] = one if outside else min(raw / np.float32(12), one)
            cells[_MEAN.contradiction] = contradiction
            cells[_MEAN.hidden] = hidden
            cells[_MEAN.excess] = excess
            cells[_MEAN.winner_difference] = to_winner
            cells[_MEAN.other_winner] = one if to_winner > one else zero
            cells[_MEAN.right_difference] = right_far
            cells[_MEAN.missing] = empty
            cells[_MEAN.color_difference] = color[y, x]
            cells[_MEAN.margin] = margin
            away = value - reference[y, x]
            filled = zero if status[y, x] == 0 else one
            cells[_MEAN.reference_difference] = min(abs(away), far)
            cells[_MEAN.other_reference] = one if abs(away) > one else zero
            cells[_MEAN.reference_filled] = filled
            cells[_ONES] = one
            single[_OWN.cost, y, x] = raw
            single[_OWN.excess, y, x] = excess
            single[_OWN.winner_difference, y, x] = to_winner
            single[_OWN.right_difference, y, x] = difference
            single[_OWN.match_column, y, x] = column
            single[_OWN.self_occlusion, y, x] = covered
            single[_OWN.rank, y, x] = np.float32(lower) / np.float32(count)
            single[_OWN.margin, y, x] = margin
            single[_OWN.missing, y, x] = empty
            single[_OWN.reference_difference, y, x] = min(max(away, -far), far)
            single[_OWN.reference_filled, y, x] = filled


@jit
def _spread(begin, end, block, planes):
    """Write the sums of a block as planes of means; the sum of ones follows the sums."""
    count, _, width = planes.shape
    for y in range(begin, end):
        for x in range(width):
            cells = block[y, x]
            f = np.float32(1) / cells[count]
            for k in range(count):
                planes[k, y, x] = cells[k] * f


@jit
def _relate(begin, end, maps, nearest, middle, farthest, above):
    # Write each map's distances to the nearest, the median and the farthest other map, and to the median of all maps.
    count, _, width = maps.shape
    far = np.float32(8)
    for y in range(begin, end):
        ordered = empty(count, np.float32)
        for x in range(width):
            for n in range(-1, count):  # -1: the values, not distances
                size = 0
                for m in range(count):
                    if m == n:
                        continue
                    value = maps[m, y, x] if n < 0 else min(abs(maps[m, y, x] - maps[n, y, x]), far)
                    at = size
                    while at > 0 and ordered[at - 1] > value:
                        ordered[at] = ordered[at - 1]
                        at -= 1
                    ordered[at] = value
                    size += 1
                if n < 0:
                    center = ordered[(count - 1) // 2]
                    for m in range(count):
                        above[m, y, x] = min(max(maps[m, y, x] - center, -far), far)
                else:
                    nearest[n, y, x] = ordered[0]
                    middle[n, y, x] = ordered[(count - 2) // 2]
                    farthest[n, y, x] = ordered[count - 2]


def hidden_by_map(values: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Select the pixels, (H, W) bool, whose match a nearer pixel of the same map covers, by more than one pixel."""
    hidden = np.empty(values.shape, np.bool_)
    run_bands(_find_hidden, len(values), values, hidden)
    return hidden


@jit
def _find_hidden(begin, end, values, out):
    for y in range(begin, end):
        nearest = nearest_matches(values[y])
        for x in range(values.shape[1]):
            u = int(np.floor(np.float32(x) - values[y, x] + np.float32(0.5)))
            out[y, x] = u >= 0 and nearest[u] - values[y, x] > np.float32(1)
