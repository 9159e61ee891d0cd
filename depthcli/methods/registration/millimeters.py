"""Expected errors in mm from the measures of the search.

Source of the isotonic regression by pool-adjacent-violators: Ayer et al. (1955).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from depthcli.methods.registration.search import CurveMeasures
from depthcli.methods.registration.smoothing import gaussian

_STRUCTURED_QUANTILE = 0.8  # of the gradient, above which a voxel counts as structured; chosen by hand
_N_BINS, _MIN_PER_BIN = 200, 20  # of the isotonic regression; chosen by hand


def structured_voxels(volume: NDArray[np.float32], inside: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Select the fifth of the voxels ``inside`` with the largest gradients: (Z, Y, X) bool, as both arguments."""
    smooth = gaussian(volume, 1.0)
    square = np.zeros_like(smooth)
    for axis in range(3):
        if smooth.shape[axis] > 1:
            square += np.gradient(smooth, axis=axis).astype(np.float32) ** 2
    structured: NDArray[np.bool_] = inside & (square >= np.quantile(square[inside], _STRUCTURED_QUANTILE))
    return structured


def expected_error(searches: list[CurveMeasures], measure: str, iso: float, sigma: float) -> NDArray[np.float32]:
    """Average a measure in mm over searches and surroundings, weighted by the inverse variance of the displacement.

    An error is smooth where a registration is, and the curves of places without texture, or of a feature that is blind
    to it, say little.

    Parameters
    ----------
    iso : side of a working voxel, mm
    sigma : of the Gaussian of the surroundings, measured places
    """
    error = np.zeros_like(searches[0].variance)
    total = np.zeros_like(error)
    for curves in searches:
        weight = np.reciprocal(curves.variance + np.float32(0.5 * iso**2))
        # Windows that do not differ by half a level of the features are the same: nothing is in doubt there.
        doubt = np.minimum(curves.maps["cost0"] * np.float32(2 * 255), 1)
        error += gaussian(curves.maps[measure] * weight * doubt, sigma)
        total += gaussian(weight, sigma)
    return error / total


def monotone(score: NDArray[np.float32], error: NDArray[np.float32], fitted: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the mean of ``error`` given ``score``, which never falls as the score rises: (Z, Y, X) float32, mm.

    Means of at most 200 bins of equally many ``fitted`` voxels, pooled where they fall (isotonic regression by
    pool-adjacent-violators). Between bins the result rises strictly wherever the score does, so that no order is
    lost; below the first bin it falls to 0 and above the last it goes on at the mean slope.

    Parameters
    ----------
    score : (Z, Y, X) float32, larger where an error is more likely, any unit
    error : (Z, Y, X) float32, mm
    fitted : (Z, Y, X) bool, the voxels that the means are taken over
    """
    x, y = score[fitted].astype(np.float64), error[fitted].astype(np.float64)
    order = np.argsort(x, kind="stable")
    groups = np.array_split(order, min(_N_BINS, max(1, len(order) // _MIN_PER_BIN)))
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
    result: NDArray[np.float32] = np.maximum(mapped, 0).astype(np.float32)
    return result


def isotonic(values: NDArray[np.float64], weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the never falling sequence nearest to ``values`` in weighted squares, by pool-adjacent-violators."""
    blocks: list[list[float]] = []
    for value, weight in zip(values.tolist(), weights.tolist(), strict=True):
        blocks.append([value, weight, 1])
        while len(blocks) > 1 and blocks[-2][0] > blocks[-1][0]:
            value, weight, count = blocks.pop()
            last = blocks[-1]
            last[0] = (last[0] * last[1] + value * weight) / (last[1] + weight)
            last[1] += weight
            last[2] += count
    return np.repeat([b[0] for b in blocks], [int(b[2]) for b in blocks])
