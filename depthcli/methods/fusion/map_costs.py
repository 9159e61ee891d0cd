"""Costs of a map at every pixel: matching, disagreement of other maps, contradiction by the right view, misfits."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.core import memory
from depthcli.kernels.jit import jit, parallel_jit, prange
from depthcli.methods.fusion.votes import BLOCK_DEPTH, NO_VOTE, ColorSupport
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


def matching_costs(maps: Map, volume: CostVolume, truncation: float, support: ColorSupport) -> Map:
    """Compute the mean over the support of the cost along every map (N, H, W), in units of the measure.

    A pixel costs ``truncation`` at most, and if its match lies outside the right image.
    """
    return _smoothed(maps, support, _along, volume.costs, np.float32(1.0 / volume.scale), np.float32(truncation))


def disagreements(maps: Map, weights: NDArray[np.float32], support: ColorSupport) -> Map:
    """Compute the mean over the support of the weighted share of the other maps (N, H, W) that disagree.

    Maps within half a pixel agree; from there to one and a half their agreement fades.
    """
    return _smoothed(maps, support, _disagree, weights, weights.sum() - weights)


def agreement(values: Map, maps: Map, weights: NDArray[np.float32]) -> Map:
    """Compute the weighted share, 0 .. 1, of maps (N, H, W) that agree with ``values`` (H, W), as in disagreements."""
    total = np.zeros(values.shape, np.float32)
    for one, weight in zip(maps, weights, strict=True):
        total += weight * np.clip(np.float32(1.5) - np.abs(one - values), 0, 1)
    return total / np.float32(weights.sum())


def contradictions(maps: Map, right: NDArray[Any], hidden: float, support: ColorSupport) -> Map:
    """Compute the mean over the support of how far the right view contradicts every map; (N, H, W) in [0, 1].

    A disparity larger than that of its match in the right view is a contradiction, since the right view could not have
    missed the nearer point: 1, fading between one and two pixels. A smaller one, or a match outside, is ``hidden``.
    """
    return _smoothed(maps, support, _contradict, right, np.float32(hidden))


def _smoothed(maps: Map, support: ColorSupport, fill: Any, *inputs: Any) -> Map:
    count, height, width = maps.shape
    out = np.empty(maps.shape, np.float32)
    block = memory.empty((height, width, BLOCK_DEPTH), np.float32)
    for first in range(0, count, BLOCK_DEPTH):
        block[:] = NO_VOTE
        fill(maps, first, *inputs, block)
        support.sum(block)
        for k in range(first, min(count, first + BLOCK_DEPTH)):
            out[k] = block[:, :, k - first] * support.inverse_sum
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


@parallel_jit
def _along(maps, first, costs, unit, truncation, block):
    height, width, n_disparities = costs.shape
    for y in prange(height):
        for k in range(min(block.shape[2], maps.shape[0] - first)):
            row = maps[first + k, y]
            for x in range(width):
                d = min(int(row[x]), n_disparities - 1)
                if d > x:
                    block[y, x, k] = truncation
                    continue
                block[y, x, k] = min(cost_between(costs[y, x], row[x]) * unit, truncation)


@parallel_jit
def _disagree(maps, first, weights, others, block):
    count, height, width = maps.shape
    zero, one, no_agreement = np.float32(0), np.float32(1), np.float32(1.5)
    for y in prange(height):
        agreement = np.empty(width, np.float32)
        for k in range(min(block.shape[2], count - first)):
            agreement[:] = 0
            own = maps[first + k, y]
            for m in range(count):
                if m == first + k:
                    continue
                weight, other = weights[m], maps[m, y]
                for x in range(own.size):
                    agreement[x] += weight * min(max(no_agreement - abs(own[x] - other[x]), zero), one)
            for x in range(width):
                block[y, x, k] = one - agreement[x] / others[first + k] if others[first + k] > 0 else zero


@parallel_jit
def _contradict(maps, first, right, hidden, block):
    count, height, width = maps.shape
    one = np.float32(1)
    for y in prange(height):
        for k in range(min(block.shape[2], count - first)):
            row = maps[first + k, y]
            for x in range(width):
                u = int(np.floor(np.float32(x) - row[x] + np.float32(0.5)))
                if u < 0:
                    block[y, x, k] = hidden
                    continue
                nearer = row[x] - np.float32(right[y, u])
                if nearer > one:
                    block[y, x, k] = min(nearer - one, one)
                elif nearer < -one:
                    block[y, x, k] = hidden
