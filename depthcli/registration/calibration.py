"""Several measures as one, on scales that the pair itself gives: no landmarks, no training set.

No single measure is safe. The likelihood's expected length is right about large errors, the costs at displacement
zero about small ones, and another descriptor errs elsewhere. Each is brought to its own median and spread over the
pair's structured voxels; their weighted sum orders the voxels, and a monotone regression of the expected length on it
gives the sum its millimeters.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from depthcli.registration._volume import gaussian
from depthcli.registration.search import SURER_IF_LARGER, Curves

_SAMPLES = 20_000
_STRUCTURED = 0.8  # quantile of the gradient above which a voxel counts as structured
_BINS = 200


def structured(volume: NDArray[np.float32], inside: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Flat indices of at most 20 000 evenly spread voxels of interest with much gradient; deterministic."""
    smooth = gaussian(volume, 1.0)
    square = np.zeros_like(smooth)
    for axis in range(3):
        if smooth.shape[axis] > 1:
            square += np.gradient(smooth, axis=axis).astype(np.float32) ** 2
    places = np.flatnonzero(inside)
    strength = square.ravel()[places]
    chosen = places[strength >= np.quantile(strength, _STRUCTURED)]
    return chosen[:: max(1, len(chosen) // _SAMPLES)]


def combine(fine: Sequence[Curves], coarse: Sequence[Curves], places: NDArray[np.int64]) -> NDArray[np.float32]:
    """Weighted sum of standardized measures, larger where the error is; no unit.

    Expected length of every feature counts 2; the Laplacian at zero of the first feature, the cost at zero of the
    last and the expected length of every coarser search 1.
    """
    parts: list[tuple[float, NDArray[np.float32]]] = [(2.0, curves.maps["eshift"]) for curves in fine]
    parts += [(1.0, _oriented(fine[0], "cur0")), (1.0, _oriented(fine[-1], "cost0"))]
    parts += [(1.0, curves.maps["eshift"]) for curves in coarse]
    total = np.zeros(fine[0].maps["eshift"].shape, np.float32)
    for weight, values in parts:
        low, middle, high = np.quantile(values.ravel()[places], [0.16, 0.5, 0.84])
        spread = float(high - low) or 1.0
        total += (values - np.float32(middle)) * np.float32(weight / spread)
    return total


def _oriented(curves: Curves, name: str) -> NDArray[np.float32]:
    values = curves.maps[name]
    return -values if name in SURER_IF_LARGER else values


def monotone(score: NDArray[np.float32], error: NDArray[np.float32], places: NDArray[np.int64]) -> NDArray[np.float32]:
    """Mean of ``error`` given ``score``, never falling: pooled over the places, then interpolated.

    Means of at most 200 bins of equally many places, pooled where they fall (isotonic regression by
    pool-adjacent-violators). Between bins the result rises strictly wherever the score does, so that no order is
    lost; below the first bin it falls to 0 and above the last it goes on at the mean slope.
    """
    x, y = score.ravel()[places].astype(np.float64), error.ravel()[places].astype(np.float64)
    order = np.argsort(x, kind="stable")
    groups = np.array_split(order, min(_BINS, max(1, len(order) // 20)))
    centers = np.array([x[group].mean() for group in groups])
    means = isotonic(np.array([y[group].mean() for group in groups]), np.array([len(g) for g in groups], float))
    centers, first = np.unique(centers, return_index=True)
    means = means[first]
    low, high = float(score.min()), float(score.max())
    slope = (means[-1] - means[0]) / (centers[-1] - centers[0]) if len(centers) > 1 else 0.0
    if high > centers[-1]:
        centers, means = np.append(centers, high), np.append(means, means[-1] + slope * (high - centers[-1]))
    if low < centers[0]:
        centers = np.insert(centers, 0, low)
        means = np.insert(means, 0, max(0.0, means[0] - slope * (centers[1] - low)))
    rise = 1e-3 * max(float(means[-1] - means[0]), 1e-3) / max(high - low, 1e-9)
    mapped = np.interp(score, centers, means + rise * (centers - centers[0]))
    result: NDArray[np.float32] = np.maximum(mapped, 0).astype(np.float32, copy=False)
    return result


def isotonic(values: NDArray[np.float64], weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """The never falling sequence nearest to ``values`` in weighted squares, by pool-adjacent-violators."""
    blocks: list[list[float]] = []
    for value, weight in zip(values.tolist(), weights.tolist(), strict=True):
        blocks.append([value, weight, 1])
        while len(blocks) > 1 and blocks[-2][0] > blocks[-1][0]:
            value, weight, count = blocks.pop()
            before = blocks[-1]
            before[0] = (before[0] * before[1] + value * weight) / (before[1] + weight)
            before[1] += weight
            before[2] += count
    return np.repeat([b[0] for b in blocks], [int(b[2]) for b in blocks])
