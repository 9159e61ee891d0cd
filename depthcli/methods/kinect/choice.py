"""One candidate for every suspect pixel: what the votes, the measurement and the neighbors agree on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.plane_fitting.window_planes import WindowPlanes
from depthcli.algorithms.trws import trws
from depthcli.kernels.jit import parallel_jit, prange

CLOSE = 4.0  # multiples of the noise: a candidate so near to the measurement stands for it
_FLOOR = 0.08  # share of votes below which candidates differ little
_SUREST = 0.97  # no measurement is right or wrong with more probability than this
_EDGE_COLOR = 12.0  # contrast (L1 in 8-bit Lab) over which smoothness fades
_LEAST_WEIGHT = 0.02
_HOPELESS = 4.0  # candidates that cost more than the cheapest by this are left out


def choose(
    pixels: NDArray[np.int32],
    values: NDArray[np.float32],
    shares: NDArray[np.float32],
    lab: NDArray[np.uint8],
    disparity: NDArray[np.float32],
    right: NDArray[np.float32],
    suspect: NDArray[np.bool_],
    planes: WindowPlanes,
    noise: float,
    smoothness: float,
    truncation: float,
    iterations: int,
) -> NDArray[np.float32]:
    """(H, W) float32: the chosen values at the suspect pixels, pixels; NaN where nothing was voted for, and elsewhere.

    The cost of a candidate is ``-ln(share + floor)`` and, where something was measured, ``-ln`` of the probability
    that it is right (for candidates close to it) or wrong; neighbors pay for differing, less across color edges.

    Parameters
    ----------
    pixels : (N, 2) int32, the suspect pixels in raster order
    values, shares : (N, K) of :func:`depthcli.methods.kinect.votes.cast_votes`
    lab : (H, W, 3) uint8
    disparity : (H, W) float32 measured, pixels, NaN = unknown
    right : (H, W) float32, probability that a measured value is right
    suspect : (H, W) bool
    planes : known surfaces; outside the suspects they are the fixed neighbors
    noise : pixels
    smoothness : weight of a difference, a multiple of the noise, between alike neighbors
    truncation : largest difference that counts, multiples of the noise
    iterations : of the message passing
    """
    chosen = np.full(disparity.shape, np.nan, np.float32)
    candidates = np.zeros((len(pixels), values.shape[1] + 1), np.float32)
    unary = np.full(candidates.shape, np.inf, np.float32)
    weights = np.zeros((len(pixels), 4), np.float32)
    _costs(
        pixels, values, shares, lab, disparity, right, suspect, planes.value, planes.slope_x, planes.slope_y,
        np.float32(noise), np.float32(smoothness), np.float32(truncation), candidates, unary, weights,
    )  # fmt: skip
    given = np.isfinite(unary[:, 0])
    pixels = pixels[given]
    if not len(pixels):
        return chosen
    active = np.zeros(disparity.shape, bool)
    active[pixels[:, 0], pixels[:, 1]] = True
    labels = trws(candidates[given], unary[given], active, weights[given], truncation * noise, iterations).labels
    chosen[active] = candidates[given][np.arange(len(pixels)), labels]
    return chosen


@parallel_jit
def _costs(  # type: ignore[no-untyped-def]
    pixels, values, shares, lab, disparity, right, suspect, value, slope_x, slope_y, noise, smoothness, truncation,
    candidates, unary, weights,
):  # fmt: skip
    height, width = disparity.shape
    most = values.shape[1]
    for n in prange(len(pixels)):
        y, x = pixels[n]
        measured = disparity[y, x]
        known = not np.isnan(measured)
        count = 0
        found = False
        for i in range(most):
            if np.isnan(values[n, i]):
                break
            candidates[n, count] = values[n, i]
            unary[n, count] = -np.log(shares[n, i] + np.float32(_FLOOR))
            found = found or (known and abs(values[n, i] - measured) < np.float32(CLOSE) * noise)
            count += 1
        if known and not found:
            candidates[n, count] = measured
            unary[n, count] = -np.log(np.float32(_FLOOR))
            count += 1
        if known:
            p = min(max(right[y, x], np.float32(1 - _SUREST)), np.float32(_SUREST))
            for i in range(count):
                close = abs(candidates[n, i] - measured) < np.float32(CLOSE) * noise
                unary[n, i] -= np.log(p) if close else np.log(np.float32(1) - p)
        for k in range(8):
            j = k % 4
            dy = 0 if j == 0 else 1
            dx = 1 if j == 0 or j == 3 else (-1 if j == 1 else 0)
            if k >= 4:
                dy, dx = -dy, -dx
            v, u = y + dy, x + dx
            if v < 0 or v >= height or u < 0 or u >= width:
                continue
            contrast = np.int32(0)
            for i in range(3):
                contrast += abs(np.int32(lab[y, x, i]) - np.int32(lab[v, u, i]))
            diagonal = np.float32(0.7 if dy != 0 and dx != 0 else 1.0)
            weight = smoothness * np.float32(np.exp(-contrast / _EDGE_COLOR)) * diagonal / noise
            weight += np.float32(_LEAST_WEIGHT)
            if k < 4:
                weights[n, k] = weight
            if not suspect[v, u] and not np.isnan(value[v, u]):
                here = value[v, u] - slope_x[v, u] * np.float32(dx) - slope_y[v, u] * np.float32(dy)
                for i in range(count):
                    unary[n, i] += weight * min(abs(candidates[n, i] - here), truncation * noise)
        # the cheap ones, in order
        least = np.float32(np.inf)
        for i in range(count):
            least = min(least, unary[n, i])
        kept = 0
        for i in range(count):
            cost, candidate = unary[n, i], candidates[n, i]
            unary[n, i] = np.inf
            if cost <= least + np.float32(_HOPELESS):
                unary[n, kept] = cost
                candidates[n, kept] = candidate
                kept += 1
