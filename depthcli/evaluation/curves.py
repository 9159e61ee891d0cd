"""Sparsification: how fast the error falls when the least confident pixels are left out."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

PERCENTAGES = (5, *range(10, 101, 5))
"""Shares of the most confident pixels at which the error rate is taken."""


@dataclass(frozen=True)
class Sparsification:
    """A sparsification curve and its areas.

    Attributes
    ----------
    percentages : share of the most confident pixels, percent
    rates : error rate among them, in [0, 1]
    error_rate : error rate e of all pixels
    auc : mean of ``rates``
    optimal : e + (1 - e) ln(1 - e), the area when all wrong pixels come last (Hu & Mordohai, PAMI 2012)
    random : e, the area of a measure that knows nothing
    ratio : auc / optimal (NaN without errors). A perfect ranking comes out a little above 1,
        since ``auc`` is a mean over steps and ``optimal`` an integral
    pixels : number of pixels
    """

    percentages: tuple[int, ...]
    rates: tuple[float, ...]
    error_rate: float
    auc: float
    optimal: float
    random: float
    ratio: float
    pixels: int


def optimal_auc(error_rate: float) -> float:
    """Area below the sparsification curve of a perfect confidence: e + (1 - e) ln(1 - e)."""
    if error_rate >= 1:
        return 1.0
    return error_rate + (1 - error_rate) * math.log1p(-error_rate)


def sparsification(confidence: NDArray[np.floating[Any]], wrong: NDArray[np.bool_]) -> Sparsification:
    """Sparsification curve of one confidence measure.

    Pixels of equal confidence have no order among themselves: a share that ends inside such a group gets the
    group's mean error rate for its part, so the curve does not depend on the order of the pixels.

    Parameters
    ----------
    confidence : (N,) higher is surer; NaN is the least sure
    wrong : (N,) bool

    Raises
    ------
    ValueError
        The lengths differ, or there is no pixel.
    """
    if confidence.shape != wrong.shape or confidence.ndim != 1 or confidence.size == 0:
        raise ValueError(f"want two (N,) arrays, N > 0, got {confidence.shape} and {wrong.shape}")
    keys = np.where(np.isnan(confidence), -np.inf, confidence)
    order = np.argsort(-keys, kind="stable")
    ordered = keys[order]
    ends = np.flatnonzero(np.append(ordered[1:] != ordered[:-1], True)) + 1
    counts = np.cumsum(wrong[order])[ends - 1]
    taken = np.array(PERCENTAGES) / 100 * wrong.size
    # Linear between the ends of tie groups = the expected number of errors over all orders.
    errors = np.interp(taken, np.append(0, ends), np.append(0, counts))
    rates = errors / taken
    e = float(np.mean(wrong))
    auc, best = float(np.mean(rates)), optimal_auc(e)
    return Sparsification(
        percentages=PERCENTAGES,
        rates=tuple(float(rate) for rate in rates),
        error_rate=e,
        auc=auc,
        optimal=best,
        random=e,
        ratio=auc / best if best > 0 else float("nan"),
        pixels=int(wrong.size),
    )
