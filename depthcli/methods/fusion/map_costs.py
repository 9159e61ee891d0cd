"""Costs of a map at every pixel: matching, disagreement of other maps, contradiction by the right view, misfits."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.kernels.color_steps import BEFORE, color_steps
from depthcli.kernels.jit import jit, run_bands
from depthcli.methods.stereo.volume import CostVolume

_ALL, _BUT_LAST, _BUT_FIRST = slice(None), slice(None, -1), slice(1, None)
NEIGHBORS = (((_ALL, _BUT_LAST), (_ALL, _BUT_FIRST)), ((_BUT_LAST, _ALL), (_BUT_FIRST, _ALL)))
"""Pixels and the next ones in their rows; pixels and the next ones in their columns."""


Map = NDArray[np.float32]


def misfit(here: Map, there: Map, slope_here: Map, slope_there: Map, truncation: float) -> Map:
    """Return the mean difference of two neighbors from the disparity that the slope of the other predicts, pixels."""
    step = there - here
    mean = np.float32(0.5) * (np.abs(step - slope_here) + np.abs(step - slope_there))
    return np.asarray(np.minimum(np.float32(truncation), mean))


def matching_costs(maps: Map, volume: CostVolume, truncation: float) -> Map:
    """Compute the cost along every map (N, H, W), in units of the measure.

    A pixel costs ``truncation`` at most, and if its match lies outside the right image.
    """
    out = np.empty(maps.shape, np.float32)
    run_bands(_along, maps.shape[1], maps, volume.costs, np.float32(1.0 / volume.scale), np.float32(truncation), out)
    return out


def disagreements(maps: Map, weights: NDArray[np.float32], out: Map | None = None) -> Map:
    """Compute the weighted share of the other maps (N, H, W) that disagree.

    Maps within half a pixel agree; from there to one and a half their agreement fades.
    """
    out = np.empty(maps.shape, np.float32) if out is None else out
    run_bands(_disagree, maps.shape[1], maps, weights, weights.sum() - weights, out)
    return out


def agreement(values: Map, maps: Map, weights: NDArray[np.float32]) -> Map:
    """Compute the weighted share, 0 .. 1, of maps (N, H, W) that agree with ``values`` (H, W), as in disagreements."""
    total = np.zeros(values.shape, np.float32)
    for one, weight in zip(maps, weights, strict=True):
        total += weight * np.clip(np.float32(1.5) - np.abs(one - values), 0, 1)
    return total / np.float32(weights.sum())


def contradictions(maps: Map, right: NDArray[Any], hidden: float) -> Map:
    """Compute how far the right view contradicts every map; (N, H, W) in [0, 1], or ``hidden``.

    A disparity larger than that of its match in the right view is a contradiction, since the right view could not have
    missed the nearer point: 1, fading between one and two pixels. A smaller one, or a match outside, is ``hidden``.
    """
    out = np.empty(maps.shape, np.float32)
    run_bands(_contradict, maps.shape[1], maps, right, np.float32(hidden), out)
    return out


def hidden_jumps(maps: Map, image: NDArray[np.uint8], out: Map | None = None) -> Map:
    """Compute how far every map (N, H, W) jumps where the color does not change, in [0, 4].

    The sum over the four neighbors of the step beyond one pixel, at most 1, times exp(-color difference / 10 levels).
    """
    out = np.empty(maps.shape, np.float32) if out is None else out
    sameness = np.exp(np.arange(256) * -0.1).astype(np.float32)
    run_bands(_hidden_jumps, maps.shape[1], maps, sameness[color_steps(image, BEFORE, largest=True)], out)
    return out


@jit
def cost_between(costs, value):
    """Return the cost of a pixel at a disparity between two whole ones."""
    d = min(int(value), costs.size - 1)
    cost = np.float32(costs[d])
    if d + 1 < costs.size:
        cost += (value - np.float32(d)) * (np.float32(costs[d + 1]) - cost)
    return cost


@jit
def nearest_matches(row):
    """Return the largest disparity of a row's pixels on every pixel of the right view, -1 where none is matched."""
    nearest = np.full(row.size, np.float32(-1))
    for x in range(row.size):
        u = int(np.floor(np.float32(x) - row[x] + np.float32(0.5)))
        if u >= 0:
            nearest[u] = max(nearest[u], row[x])
    return nearest


@jit
def match_in_right(x, value, right):
    """Return the column of pixel ``x``'s match, below 0 outside, and by how much it is nearer than ``right`` there.

    ``right`` are the disparities of a row of the right view.
    """
    u = int(np.floor(np.float32(x) - value + np.float32(0.5)))
    return u, value - np.float32(right[max(u, 0)])


@jit
def warped_right(x, value, image, other, grey):
    """Return the right view's grey level at the match of pixel ``x``, and the largest channel difference to it.

    ``image`` and ``other`` are a row of the left and of the right color image, ``grey`` is of the right one.
    """
    at = min(max(np.float32(x) - value, np.float32(0)), np.float32(grey.size - 1))
    low = int(at)
    high = min(low + 1, grey.size - 1)
    rest = at - np.float32(low)
    largest = np.float32(0)
    for c in range(3):
        a, b = np.float32(other[low, c]), np.float32(other[high, c])
        largest = max(largest, abs(np.float32(image[x, c]) - (a + rest * (b - a))))
    return grey[low] + rest * (grey[high] - grey[low]), largest


@jit
def _along(begin, end, maps, costs, unit, truncation, out):
    count, _, width = maps.shape
    for y in range(begin, end):
        for k in range(count):
            row = maps[k, y]
            for x in range(width):
                d = min(int(row[x]), costs.shape[2] - 1)
                out[k, y, x] = truncation if d > x else min(cost_between(costs[y, x], row[x]) * unit, truncation)


@jit
def _disagree(begin, end, maps, weights, others, out):
    count, _, width = maps.shape
    zero, one, no_agreement = np.float32(0), np.float32(1), np.float32(1.5)
    for y in range(begin, end):
        agreement = np.empty(width, np.float32)
        for k in range(count):
            agreement[:] = 0
            own = maps[k, y]
            for m in range(count):
                if m == k:
                    continue
                weight, other = weights[m], maps[m, y]
                for x in range(own.size):
                    agreement[x] += weight * min(max(no_agreement - abs(own[x] - other[x]), zero), one)
            for x in range(width):
                out[k, y, x] = one - agreement[x] / others[k] if others[k] > 0 else zero


@jit
def _contradict(begin, end, maps, right, hidden, out):
    count, _, width = maps.shape
    zero, one = np.float32(0), np.float32(1)
    for y in range(begin, end):
        for k in range(count):
            row = maps[k, y]
            for x in range(width):
                u, nearer = match_in_right(x, row[x], right[y])
                out[k, y, x] = hidden if u < 0 or nearer < -one else min(max(nearer - one, zero), one)


@jit
def _hidden_jumps(begin, end, maps, same, out):
    # ``same`` (2, H, W): how alike the colors of a pixel and the one to its left, above it are.
    count, height, width = maps.shape
    for y in range(begin, end):
        for k in range(count):
            row = maps[k, y]
            for x in range(width):
                jumps = np.float32(0)
                if x > 0:
                    jumps += same[0, y, x] * _jump(row[x], row[x - 1])
                if x + 1 < width:
                    jumps += same[0, y, x + 1] * _jump(row[x], row[x + 1])
                if y > 0:
                    jumps += same[1, y, x] * _jump(row[x], maps[k, y - 1, x])
                if y + 1 < height:
                    jumps += same[1, y + 1, x] * _jump(row[x], maps[k, y + 1, x])
                out[k, y, x] = jumps


@jit
def _jump(value, other):
    return min(max(abs(value - other) - np.float32(1), np.float32(0)), np.float32(1))
