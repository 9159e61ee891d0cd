"""Planes: what the images, the map itself and other maps say about every pixel of a disparity map."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.filters import local_moments
from depthcli.core import memory
from depthcli.kernels.jit import parallel_jit, prange
from depthcli.methods.fusion.choice._inputs import correlation
from depthcli.methods.fusion.map_costs import cost_between, disagreements
from depthcli.methods.fusion.support import BLOCK_DEPTH, NO_VOTE
from depthcli.methods.given_maps._evidence import Evidence

AVERAGED = (
    "cost", "far_cost", "contradiction", "hidden", "excess", "winner_difference", "other_winner", "right_difference",
    "missing", "color_difference", "margin", "reference_difference", "other_reference", "reference_filled",
)  # fmt: skip
SINGLE = (
    "cost", "excess", "winner_difference", "right_difference", "match_column", "self_occlusion", "rank", "margin",
    "missing", "reference_difference", "reference_filled",
)  # fmt: skip
SHAPE = (
    "decorrelation", "color_difference", "deviation_of_map_5", "deviation_of_map_11", "deviation_of_map_21",
    "deviation_of_map_41", "above_mean_11", "above_mean_25", "above_median_5", "above_median_21", "edge_distance",
    "step_right", "step_left", "step_around", "relative",
)  # fmt: skip
PIXEL = (
    "deviation_5",
    "deviation_13",
    "deviation_31",
    "gradient",
    "light_trust",
    "min_cost",
    "peak",
    "border_distance",
)
ALONE = (*(f"{n}_narrow" for n in AVERAGED), *(f"{n}_wide" for n in AVERAGED), *SINGLE, *SHAPE, *PIXEL)
OTHERS = (
    "disagreement_narrow", "disagreement_wide", "nearest_map", "middle_map", "farthest_map", "above_middle",
    "cost_narrow_relative", "cost_wide_relative", "excess_narrow_relative", "decorrelation_relative",
    "deviation_of_map_11_relative", "maps",
)  # fmt: skip
INPUTS = (*ALONE, *OTHERS)

_FAR = np.float32(8.0)
_WINDOW = 7


def alone_planes(
    values: NDArray[np.float32], missing: NDArray[np.bool_], evidence: Evidence, shared: dict[str, Any]
) -> NDArray[np.float32]:
    """Return the planes ``ALONE`` of a map without gaps, (len(ALONE), H, W) float32."""
    height, width = values.shape
    out = memory.empty((len(ALONE), height, width), np.float32)
    plane = {name: out[k] for k, name in enumerate(ALONE)}
    block = memory.empty((height, width, BLOCK_DEPTH), np.float32)
    single = memory.empty((len(SINGLE), height, width), np.float32)
    warped = np.empty((height, width), np.float32)
    unit, optimized_unit = np.float32(1 / evidence.volume.scale), np.float32(1 / evidence.optimized.scale)
    _compare(
        values,
        missing.view(np.uint8),
        evidence.volume.costs,
        evidence.optimized.costs,
        unit,
        optimized_unit,
        evidence.left,
        evidence.right,
        *evidence.pair.color8,
        evidence.grey[1],
        shared["min_cost"],
        evidence.reference.values,
        evidence.reference.status,
        block,
        single,
        warped,
        plane["color_difference"],
    )
    for k, name in enumerate(SINGLE):
        plane[name][:] = single[k]
    work = block.copy()
    for support, suffix, array in ((evidence.narrow, "narrow", block), (evidence.wide, "wide", work)):
        support.sum(array)
        for k, name in enumerate(AVERAGED):
            np.multiply(array[:, :, k], support.inverse_sum, out=plane[f"{name}_{suffix}"])
    grey = evidence.grey[0]
    plane["decorrelation"][:] = 1 - correlation(grey, local_moments(grey, _WINDOW), warped)
    for side in (5, 11, 21, 41):
        plane[f"deviation_of_map_{side}"][:] = np.minimum(np.sqrt(local_moments(values, side)[1]), 10)
    for side in (11, 25):
        plane[f"above_mean_{side}"][:] = np.clip(values - cv2.blur(values, (side, side)), -6, 6)
    plane["above_median_5"][:] = np.clip(values - cv2.medianBlur(values, 5), -6, 6)
    top = np.float32(max(evidence.volume.n_disparities - 1, 1))
    coarse = cv2.medianBlur((values * (255 / top)).astype(np.uint8), 21).astype(np.float32) * (top / 255)
    plane["above_median_21"][:] = np.clip(values - coarse, -8, 8)
    edges = np.zeros((height, width), np.uint8)
    edges[:, 1:] |= np.abs(np.diff(values, axis=1)) > 1
    edges[1:] |= np.abs(np.diff(values, axis=0)) > 1
    plane["edge_distance"][:] = np.minimum(cv2.distanceTransform(1 - edges, cv2.DIST_L2, 3), 30) if edges.any() else 30
    line = np.ones((1, 15), np.uint8)
    plane["step_right"][:] = np.minimum(cv2.dilate(values, line, anchor=(0, 0)) - values, 12)
    plane["step_left"][:] = np.minimum(cv2.dilate(values, line, anchor=(14, 0)) - values, 12)
    plane["step_around"][:] = np.minimum(values - cv2.erode(values, np.ones((9, 9), np.uint8)), 12)
    plane["relative"][:] = values / top
    for name, array in shared.items():
        plane[name][:] = array
    columns = np.arange(width, dtype=np.float32)
    rows = np.arange(height, dtype=np.float32)[:, None]
    plane["border_distance"][:] = np.minimum(
        np.minimum(np.minimum(columns, width - 1 - columns), np.minimum(rows, height - 1 - rows)), 20
    )
    return out


def other_planes(
    maps: NDArray[np.float32], alone: list[NDArray[np.float32]], evidence: Evidence
) -> NDArray[np.float32]:
    """Return the planes ``OTHERS`` of every map, (N, len(OTHERS), H, W) float32; all 0 where there is one map."""
    count, height, width = maps.shape
    out = np.zeros((count, len(OTHERS), height, width), np.float32)
    if count == 1:
        return out
    index = {name: k for k, name in enumerate(OTHERS)}
    weight = np.ones(count, np.float32)
    for name, support in (("narrow", evidence.narrow), ("wide", evidence.wide)):
        out[:, index[f"disagreement_{name}"]] = disagreements(maps, weight, support)
    middle = np.partition(maps, (count - 1) // 2, axis=0)[(count - 1) // 2]
    for n in range(count):
        distance = np.sort(np.minimum(np.abs(np.delete(maps, n, axis=0) - maps[n]), _FAR), axis=0)
        out[n, index["nearest_map"]] = distance[0]
        out[n, index["middle_map"]] = distance[(count - 2) // 2]
        out[n, index["farthest_map"]] = distance[-1]
        out[n, index["above_middle"]] = np.clip(maps[n] - middle, -_FAR, _FAR)
    for name in OTHERS:
        if name.endswith("_relative"):
            k = ALONE.index(name.removesuffix("_relative"))
            low = alone[0][k].copy()
            for one in alone[1:]:
                np.minimum(low, one[k], out=low)
            for n in range(count):
                np.subtract(alone[n][k], low, out=out[n, index[name]])
    out[:, index["maps"]] = np.log2(np.float32(count))
    return out


@parallel_jit
def _compare(
    values: Any, missing: Any, costs: Any, optimized: Any, unit: Any, optimized_unit: Any, left: Any, right: Any,
    image: Any, other: Any, other_grey: Any, best: Any, reference: Any, status: Any, block: Any, single: Any,
    warped: Any, color: Any,
) -> None:  # fmt: skip
    height, width = values.shape
    n_disparities = costs.shape[2]
    last, half, one, zero = np.float32(width - 1), np.float32(0.5), np.float32(1), np.float32(0)
    far, soft = np.float32(8), np.float32(2)
    for y in prange(height):
        nearest = np.full(width, np.float32(-1))
        for x in range(width):
            u = int(np.floor(np.float32(x) - values[y, x] + half))
            if u >= 0:
                nearest[u] = max(nearest[u], values[y, x])
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
            least = np.uint16(65535)
            for d in range(count):
                lower += np.uint16(row[d] < bound)
            for d in range(max(0, min(v - 1, count))):
                least = min(least, row[d])
            for d in range(v + 2, count):
                least = min(least, row[d])
            c_here, c_winner = here * optimized_unit, best[y, x]
            excess = min(np.float32(np.log((c_here + soft) / (c_winner + soft))), soft)
            margin = min(
                max(np.float32(np.log((np.float32(least) * optimized_unit + soft) / (c_here + soft))), -soft), soft
            )
            to_winner = min(abs(value - winner), far)
            column = min(max(np.float32(x) - value, np.float32(-20)), np.float32(20))
            u = int(np.floor(np.float32(x) - value + half))
            contradiction, hidden, difference, covered, right_far = zero, zero, np.float32(-6), zero, far
            if u >= 0:
                there = value - np.float32(right[y, u])
                difference = min(max(there, np.float32(-5)), np.float32(5))
                right_far = min(abs(there), far)
                covered = min(nearest[u] - value, np.float32(6))
                if there > one:
                    contradiction = min(there - one, one)
                elif there < -one:
                    hidden = one
            else:
                hidden = one
            at = min(max(np.float32(x) - value, zero), last)
            low = int(at)
            high = min(low + 1, width - 1)
            rest = at - np.float32(low)
            warped[y, x] = other_grey[y, low] + rest * (other_grey[y, high] - other_grey[y, low])
            largest = zero
            for c in range(3):
                a, b = np.float32(other[y, low, c]), np.float32(other[y, high, c])
                largest = max(largest, abs(np.float32(image[y, x, c]) - (a + rest * (b - a))))
            color[y, x] = min(largest, np.float32(40))
            empty = np.float32(missing[y, x])
            cells[0] = one if outside else min(raw / np.float32(30), one)
            cells[1] = one if outside else min(raw / np.float32(12), one)
            cells[2] = contradiction
            cells[3] = hidden
            cells[4] = excess
            cells[5] = to_winner
            cells[6] = one if to_winner > one else zero
            cells[7] = right_far
            cells[8] = empty
            cells[9] = color[y, x]
            cells[10] = margin
            away = value - reference[y, x]
            filled = zero if status[y, x] == 0 else one
            cells[11] = min(abs(away), far)
            cells[12] = one if abs(away) > one else zero
            cells[13] = filled
            single[0, y, x] = raw
            single[1, y, x] = excess
            single[2, y, x] = to_winner
            single[3, y, x] = difference
            single[4, y, x] = column
            single[5, y, x] = covered
            single[6, y, x] = np.float32(lower) / np.float32(count)
            single[7, y, x] = margin
            single[8, y, x] = empty
            single[9, y, x] = min(max(away, -far), far)
            single[10, y, x] = filled
