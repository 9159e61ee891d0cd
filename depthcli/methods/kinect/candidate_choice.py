"""The choice of one candidate disparity for every unreliable pixel, by its votes, its measurement and its neighbors."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.plane_fitting.window_planes import WindowPlanes
from depthcli.algorithms.trws import trws
from depthcli.kernels.jit import jit, parallel_jit, prange

# Values that the preset refine-kinect accurate was published with; nothing in the repository varies them.
AGREEMENT = 4.0
"""A candidate agrees with the measurement if it differs by less than this, multiples of the noise."""
_MIN_SHARE = 0.08  # added to every share of votes, so that small shares cost about the same
_MAX_PROBABILITY = 0.97  # largest probability that a measurement is correct, and that it is wrong
_EDGE_COLOR = 12.0  # contrast over which smoothness falls by 1/e, L1 in 8-bit Lab
_MIN_WEIGHT = 0.02  # of smoothness, across the strongest color edge
_MAX_EXTRA_COST = 4.0  # candidates that cost more than the cheapest by this are left out
_NEIGHBORS = ((0, 1), (1, -1), (1, 0), (1, 1), (0, -1), (-1, 1), (-1, 0), (-1, -1))  # dy, dx: first those behind it


def choose_candidates(
    pixels: NDArray[np.int32],
    values: NDArray[np.float32],
    shares: NDArray[np.float32],
    lab: NDArray[np.uint8],
    disparity: NDArray[np.float32],
    p_correct: NDArray[np.float32],
    unreliable: NDArray[np.bool_],
    planes: WindowPlanes,
    noise: float,
    smoothness: float,
    truncation: float,
    iterations: int,
) -> NDArray[np.float32]:
    """Choose a value for every unreliable pixel, (H, W) float32; NaN where it has no candidate, and elsewhere.

    The cost of a candidate is ``-ln(share + 0.08)`` and, where something was measured, ``-ln`` of the probability
    that it is correct (for candidates close to it) or wrong; differences of neighbors cost, less across color edges.
    TRW-S minimizes the sum.

    Parameters
    ----------
    pixels : (N, 2) int32, the unreliable pixels in raster order
    values, shares : (N, K) of :func:`depthcli.methods.kinect.candidates.cast_votes`
    lab : (H, W, 3) uint8
    disparity : (H, W) float32 measured, pixels, NaN = unknown
    p_correct : (H, W) float32, probability that a measured value is correct
    unreliable : (H, W) bool
    planes : known surfaces; at reliable pixels they are the fixed neighbors
    noise : pixels
    smoothness : weight of a difference, in units of the noise, between neighbors of one color
    truncation : largest difference that counts, multiples of the noise
    iterations : of the message passing
    """
    chosen = np.full(disparity.shape, np.nan, np.float32)
    candidates = np.zeros((len(pixels), values.shape[1] + 1), np.float32)
    unary = np.full(candidates.shape, np.inf, np.float32)
    weights = np.zeros((len(pixels), 4), np.float32)
    _costs(
        pixels, values, shares, lab, disparity, p_correct, unreliable, planes.value, planes.slope_x, planes.slope_y,
        np.float32(noise), np.float32(smoothness), np.float32(truncation), candidates, unary, weights,
    )  # fmt: skip
    has_candidates = np.isfinite(unary[:, 0])
    pixels = pixels[has_candidates]
    if not len(pixels):
        return chosen
    active = np.zeros(disparity.shape, bool)
    active[pixels[:, 0], pixels[:, 1]] = True
    candidates, unary, weights = candidates[has_candidates], unary[has_candidates], weights[has_candidates]
    labels, _ = trws(candidates, unary, active, weights, truncation * noise, iterations)
    chosen[active] = candidates[np.arange(len(pixels)), labels]
    return chosen


@parallel_jit
def _costs(
    pixels, values, shares, lab, disparity, p_correct, unreliable, value, slope_x, slope_y, noise, smoothness,
    truncation, candidates, unary, weights,
):  # fmt: skip
    height, width = disparity.shape
    for n in prange(len(pixels)):
        y, x = pixels[n]
        measured = disparity[y, x]
        known = not np.isnan(measured)
        count = 0
        agreed = False
        for i in range(values.shape[1]):
            if np.isnan(values[n, i]):
                break
            candidates[n, count] = values[n, i]
            unary[n, count] = -np.log(shares[n, i] + np.float32(_MIN_SHARE))
            agreed = agreed or (known and abs(values[n, i] - measured) < np.float32(AGREEMENT) * noise)
            count += 1
        if known and not agreed:
            candidates[n, count] = measured
            unary[n, count] = -np.log(np.float32(_MIN_SHARE))
            count += 1
        if known:
            p = min(max(p_correct[y, x], np.float32(1 - _MAX_PROBABILITY)), np.float32(_MAX_PROBABILITY))
            for i in range(count):
                close = abs(candidates[n, i] - measured) < np.float32(AGREEMENT) * noise
                unary[n, i] -= np.log(p) if close else np.log(np.float32(1) - p)
        for k in range(8):
            dy, dx = _NEIGHBORS[k]
            v, u = y + dy, x + dx
            if v < 0 or v >= height or u < 0 or u >= width:
                continue
            contrast = np.int32(0)
            for i in range(3):
                contrast += abs(np.int32(lab[y, x, i]) - np.int32(lab[v, u, i]))
            diagonal = np.float32(0.7 if dy != 0 and dx != 0 else 1.0)
            weight = smoothness * np.float32(np.exp(-contrast / _EDGE_COLOR)) * diagonal / noise
            weight += np.float32(_MIN_WEIGHT)
            if k < 4:
                weights[n, k] = weight
            if not unreliable[v, u] and not np.isnan(value[v, u]):
                here = value[v, u] - slope_x[v, u] * np.float32(dx) - slope_y[v, u] * np.float32(dy)
                for i in range(count):
                    unary[n, i] += weight * min(abs(candidates[n, i] - here), truncation * noise)
        _drop_expensive(unary[n], candidates[n], count)


@jit
def _drop_expensive(unary, candidates, count):
    # Moves the cheap candidates to the front, in order; the cost of the others becomes infinite.
    cheapest = np.float32(np.inf)
    for i in range(count):
        cheapest = min(cheapest, unary[i])
    kept = 0
    for i in range(count):
        cost, candidate = unary[i], candidates[i]
        unary[i] = np.inf
        if cost <= cheapest + np.float32(_MAX_EXTRA_COST):
            unary[kept] = cost
            candidates[kept] = candidate
            kept += 1
