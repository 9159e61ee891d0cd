"""The measures by name, computed together in as few passes over the costs as they need."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator

from depthcli.kernels.winners import left_right_difference, winners
from depthcli.methods.confidence._curves import CURVE_MEASURES, measure_curves, moments
from depthcli.methods.confidence._neighbors import agreement, average_peak_ratio, mutual_agreement

_DESCRIPTIONS = {
    "msm": "matching score: -c1",
    "cur": "curvature at the minimum: c(d1 - 1) + c(d1 + 1) - 2 c1",
    "pkr": "peak ratio: second smallest local minimum / c1",
    "pkrn": "naive peak ratio: c2 / c1",
    "mm": "maximum margin: second smallest local minimum - c1",
    "mmn": "naive maximum margin: c2 - c1",
    "wmn": "winner margin: (second smallest local minimum - c1) / sum of c",
    "wmnn": "naive winner margin: (c2 - c1) / sum of c",
    "mlm": "maximum likelihood: exp(-2 c1) / sum of exp(-2 c), costs in standard deviations",
    "aml": "attainable maximum likelihood: 1 / sum of exp(-8 (c - c1)^2)",
    "nem": "negative entropy of softmax(-4 c)",
    "noi": "minus the number of local minima of the smoothed curve",
    "lrc": "left-right consistency: -|d1 - right view's d|",
    "lrd": "left-right difference: (c2 - c1) / (c1 - cheapest cost of the right pixel)",
    "da": "disparity agreement: share of a 25 x 25 window within 1 px of d1",
    "apkr": "average peak ratio: peak ratio of the 5 x 5 window at the center's two disparities",
    "dap": "da of both views in 13 x 13 windows around the match, times (1 - 1 / apkr)^0.5: what all agree on",
}
_VIEW_MEASURES = ("lrc", "lrd")
_AGREEMENT_RADIUS = 12
_PEAK_RADIUS = 2
_JOINT_RADIUS = 6


def measure_name(name: str, *others: str) -> str:
    """The measure's own spelling of ``name``, in any case; ValueError where it is neither one nor in ``others``."""
    plain = name.lower()
    if plain not in (*others, *_DESCRIPTIONS):
        raise ValueError(f"no confidence measure called {name!r}; one of: {', '.join((*others, *_DESCRIPTIONS))}")
    return plain


MeasureName = Annotated[str, AfterValidator(measure_name)]
"""A measure as configs name it."""


def measures() -> dict[str, str]:
    """Name -> one-line description of every measure. In all of them a larger value means surer."""
    return dict(_DESCRIPTIONS)


@dataclass(frozen=True)
class Curves:
    """What one pass over cost curves gives.

    Attributes
    ----------
    maps : measure -> (...,) float32
    winner : (...,) int32, index of the smallest cost, the first one of equals
    second : (...,) int32, index of the second smallest local minimum; -1: there is none
    eps : guard of the ratios, 1e-3 of the mean cost, in stored units
    """

    maps: dict[str, NDArray[np.float32]]
    winner: NDArray[np.int32]
    second: NDArray[np.int32]
    eps: float


def curve_measures(
    costs: NDArray[Any], names: Iterable[str] = CURVE_MEASURES, valid: NDArray[Any] | None = None
) -> Curves:
    """Measures of single curves.

    ``c1`` is the smallest cost, ``c2`` the next smallest anywhere, ``c2m`` the next smallest local minimum
    (below its left neighbor, not above its right one; the ends of the curve count). Without a second local
    minimum ``c2m`` is the largest cost; a curve of one entry has ``c2 = c2m = c1``. Likelihoods and entropy
    see costs in units of the standard deviation of all valid cells.

    Parameters
    ----------
    costs : (..., K) uint8, uint16 or float32, finite, lower is better
    names : measures wanted, out of ``CURVE_MEASURES``
    valid : (...,) integers in 1 .. K; only the first ``valid`` entries of a curve take part. Default: all

    Raises
    ------
    ValueError
        For an unknown name, an empty curve or a count outside 1 .. K.
    """
    wanted = _check(names, CURVE_MEASURES)
    if costs.ndim < 2 or costs.shape[-1] < 1:
        raise ValueError(f"want costs (..., K) with K >= 1, got {costs.shape}")
    depth = costs.shape[-1]
    shape = costs.shape[:-1]
    rows = costs.reshape(-1, shape[-1], depth)
    if valid is None:
        counts = np.full(rows.shape[:2], depth, np.int32)
    else:
        counts = np.broadcast_to(valid, shape).reshape(rows.shape[:2]).astype(np.int32)
        if counts.size and (counts.min() < 1 or counts.max() > depth):
            raise ValueError(f"valid entries must lie in 1 .. {depth}")
    mean, deviation = _mean_and_deviation(rows, counts)
    eps = _guard(mean)
    planes = np.empty((len(CURVE_MEASURES), *rows.shape[:2]), np.float32)
    winner = np.empty(rows.shape[:2], np.int32)
    second = np.empty(rows.shape[:2], np.int32)
    measure_curves(rows, counts, np.float32(1.0 / deviation), np.float32(eps), planes, winner, second)
    maps = {name: planes[CURVE_MEASURES.index(name)].reshape(shape) for name in wanted}
    return Curves(maps, winner.reshape(shape), second.reshape(shape), eps)


def confidence_maps(costs: NDArray[Any], names: Iterable[str]) -> dict[str, NDArray[np.float32]]:
    """Measures of a stereo cost volume, all of them together.

    Parameters
    ----------
    costs : (H, W, D) uint8, uint16 or float32, finite; cells with d > x take no part
    names : measures wanted, any of :func:`measures`

    Returns
    -------
    name -> (H, W) float32, larger is surer, in the order asked for

    Raises
    ------
    ValueError
        For an unknown name or costs that are no volume.
    """
    wanted = _check(names, _DESCRIPTIONS)
    if costs.ndim != 3 or 0 in costs.shape:
        raise ValueError(f"want costs (H, W, D), got {costs.shape}")
    height, width, depth = costs.shape
    valid = np.broadcast_to(np.minimum(np.arange(1, width + 1, dtype=np.int32), depth), (height, width))
    maps: dict[str, NDArray[np.float32]] = {}
    blank = np.zeros((height, width), np.float32)
    if set(wanted) - {"lrc"}:
        curves = curve_measures(costs, valid=valid)
        maps |= curves.maps
        if "da" in wanted:
            maps["da"] = np.empty_like(blank)
            agreement(curves.winner, _AGREEMENT_RADIUS, maps["da"])
        if {"apkr", "dap"} & set(wanted):
            maps["apkr"] = np.empty_like(blank)
            average_peak_ratio(
                costs, valid, curves.winner, curves.second, np.float32(curves.eps), _PEAK_RADIUS, maps["apkr"]
            )
    if {*_VIEW_MEASURES, "dap"} & set(wanted):
        left, right = winners(costs)
        maps["lrc"] = -left_right_difference(left, right)
        if "lrd" in wanted:
            rows, partner = np.arange(height)[:, None], np.arange(width) - left.astype(np.int64)
            best = right[rows, partner].astype(np.int64)
            cheapest = costs[rows, partner + best, best].astype(np.float32)
            maps["lrd"] = maps["mmn"] / (-maps["msm"] - cheapest + np.float32(curves.eps))
    if "dap" in wanted:
        ours, theirs = np.empty_like(blank), np.empty_like(blank)
        agreement(curves.winner, _JOINT_RADIUS, ours)
        mutual_agreement(curves.winner, right, _JOINT_RADIUS, theirs)
        distinct = np.sqrt(np.maximum(1 - 1 / maps["apkr"], 0))
        maps["dap"] = (ours * theirs * distinct).astype(np.float32)
    return {name: maps[name] for name in wanted}


def _check(names: Iterable[str], known: Iterable[str]) -> list[str]:
    wanted = list(dict.fromkeys([names] if isinstance(names, str) else names))
    for name in wanted:
        if name not in known:
            raise ValueError(f"no confidence measure called {name!r}; one of: {', '.join(known)}")
    return wanted


def _mean_and_deviation(rows: NDArray[Any], counts: NDArray[np.int32]) -> tuple[float, float]:
    sums = np.empty((rows.shape[0], 2))
    moments(rows, counts, sums)
    total, squares = sums.sum(axis=0)
    cells = max(1, int(counts.sum(dtype=np.int64)))
    mean = total / cells
    deviation = float(np.sqrt(max(squares / cells - mean * mean, 0.0)))
    return float(mean), deviation if deviation > 1e-6 * abs(mean) and deviation > 0 else 1.0


def _guard(mean: float) -> float:
    return 1e-3 * abs(mean) or 1e-3
