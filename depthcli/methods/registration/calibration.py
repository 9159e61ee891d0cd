"""Measures to millimeters: on the scale of the pair itself, or by a monotone model fitted to known errors.

No single measure is safe, and none has the right unit: where tissue has no texture, the likelihood of the displacements
is as broad as the search, and its expected length says more about the search than about the registration. What is
fitted here never falls with any measure. Sources: isotonic regression by pool-adjacent-violators (Ayer et al.
1955); stagewise additive fitting after Friedman (Annals of Statistics 2001).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from depthcli.methods.registration._volume import gaussian
from depthcli.methods.registration.search import SURER_IF_LARGER, Curves

Maps = dict[str, NDArray[np.float32]]

_SAMPLES = 20_000
_STRUCTURED = 0.8  # quantile of the gradient above which a voxel counts as structured
_BINS = 200
_USED = ("eshift", "vshift", "mlm0", "rank0", "cur0", "cost0")
_SMOOTH = (1.0, 2.0, 4.0)  # working voxels
_ROUNDS, _RATE = 200, 0.1


def structured(volume: NDArray[np.float32], inside: NDArray[np.bool_], share: float = _STRUCTURED) -> NDArray[np.int64]:
    """Flat indices of at most 20 000 evenly spread voxels of interest with much gradient; deterministic."""
    smooth = gaussian(volume, 1.0)
    square = np.zeros_like(smooth)
    for axis in range(3):
        if smooth.shape[axis] > 1:
            square += np.gradient(smooth, axis=axis).astype(np.float32) ** 2
    places = np.flatnonzero(inside)
    strength = square.ravel()[places]
    chosen = places[strength >= np.quantile(strength, share)]
    return chosen[:: max(1, len(chosen) // _SAMPLES)]


def expected(searches: list[Curves], measure: str, iso: float, sigma: float) -> NDArray[np.float32]:
    """A measure in mm, averaged over searches and surroundings with the inverse variance of the displacement.

    An error is smooth where a registration is, and the curves of places without texture, or of a feature that is blind
    to it, say little. ``iso``: mm a voxel; ``sigma`` of the surroundings, places.
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


def evidence_names(fine: int, coarse: int) -> list[str]:
    """What :func:`evidence` makes of so many searches."""
    names = [f"{name}_{k}" for k in range(fine + coarse) for name in _USED]
    return [*names, "mean", *(f"smooth_{sigma:g}" for sigma in _SMOOTH), *(f"coarse_{k}" for k in range(coarse))]


def evidence(fine: list[Curves], coarse: list[Curves], iso: float, stride: int) -> tuple[Maps, NDArray[np.float32]]:
    """Everything that grows with the error, and the displacement smoothed (3, z, y, x), mm.

    Smoothed: means of the expected displacements of all features, weighted by the inverse square of their variance.
    An error is smooth where a registration is; what texture says is carried to where there is none.
    """
    maps: Maps = {}
    for k, curves in enumerate(fine + coarse):
        for name in _USED:
            values = curves.maps[name]
            maps[f"{name}_{k}"] = -values if name in SURER_IF_LARGER else values
    maps["mean"] = expected(fine + coarse, "eshift", iso, 2 / stride)
    floor = 0.5 * iso**2
    weights = [np.reciprocal(curves.variance + np.float32(floor)) for curves in fine]
    total = np.zeros_like(weights[0])
    mean = np.zeros_like(fine[0].displacement)
    for curves, weight in zip(fine, weights, strict=True):
        total += weight
        mean += curves.displacement * weight
    mean /= total
    smooth = mean
    for sigma in _SMOOTH:
        smooth = _weighted(mean, total * total, sigma / stride)
        maps[f"smooth_{sigma:g}"] = length(smooth)
        if sigma == 2:
            displacement = smooth
    for k, curves in enumerate(coarse):
        weight = np.reciprocal(curves.variance + np.float32(floor * 4 ** (k + 1)))
        far = _weighted(curves.displacement, weight * weight, 3.0 * 2**k / stride)
        maps[f"coarse_{k}"] = length(far)
        reach = np.float32(5 * iso * 2**k)
        share = np.clip(length(far) / reach - np.float32(0.6), 0, 1)
        displacement = displacement + share * (far - displacement)
    return maps, displacement


@dataclass(frozen=True)
class MonotoneModel:
    """Sum of functions of single measures, none of which ever falls.

    Attributes
    ----------
    base : mm
    centers, steps : measure -> (n,) values, and what is added there, mm; linear between, flat outside
    """

    base: float
    centers: dict[str, NDArray[np.float64]]
    steps: dict[str, NDArray[np.float64]]

    def __call__(self, maps: Mapping[str, NDArray[np.float32]]) -> NDArray[np.float32]:
        """Expected error, mm, at least 0."""
        total: NDArray[np.float64] | None = None
        for name, centers in self.centers.items():
            part = np.interp(maps[name], centers, self.steps[name])
            total = part if total is None else total + part
        assert total is not None
        return np.maximum(total + self.base, 0).astype(np.float32)


def fit(table: Mapping[str, NDArray[np.float32]], error: NDArray[np.float32]) -> MonotoneModel:
    """Fit the model by squared error, one small isotonic step of the most useful measure at a time.

    Parameters
    ----------
    table : measure -> (n,), larger where the error is larger
    error : (n,) mm
    """
    y = error.astype(np.float64)
    base = float(y.mean())
    left = y - base
    bins: dict[str, NDArray[np.int64]] = {}
    centers, steps = {}, {}
    for name, values in table.items():
        edges = np.unique(np.quantile(values, np.linspace(0, 1, _BINS + 1)[1:-1]))
        index = np.searchsorted(edges, values)
        counts = np.bincount(index, minlength=len(edges) + 1)
        sums = np.bincount(index, values, len(edges) + 1)
        known = counts > 0
        rank = np.cumsum(known) - 1
        bins[name] = rank[index]
        centers[name] = sums[known] / counts[known]
        steps[name] = np.zeros(len(centers[name]))
    counted = {name: np.bincount(index).astype(float) for name, index in bins.items()}
    for _ in range(_ROUNDS):
        best, gain, step = "", 0.0, np.zeros(0)
        for name, index in bins.items():
            count = counted[name]
            found = isotonic(np.bincount(index, left, len(count)) / count, count)
            won = float((count * found * found).sum())
            if won > gain:
                best, gain, step = name, won, found
        if gain <= 1e-6 * len(y):
            break
        steps[best] += _RATE * step
        left -= _RATE * step[bins[best]]
    used = [name for name in steps if steps[name].any()] or list(steps)[:1]
    return MonotoneModel(base, {name: centers[name] for name in used}, {name: steps[name] for name in used})


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


def _weighted(field: NDArray[np.float32], weight: NDArray[np.float32], sigma: float) -> NDArray[np.float32]:
    """Gaussian mean of each component with a weight a voxel."""
    total = gaussian(weight, sigma)
    return np.stack([gaussian(part * weight, sigma) / total for part in field])


def length(field: NDArray[np.float32]) -> NDArray[np.float32]:
    """(Z, Y, X) lengths of (3, Z, Y, X) vectors."""
    found: NDArray[np.float32] = np.sqrt((field * field).sum(axis=0))
    return found
