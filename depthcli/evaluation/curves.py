"""Sparsification: how fast the error falls when the least confident pixels are left out."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

PERCENTAGES = (5, *range(10, 101, 5))
"""Shares of the most confident pixels at which curves are drawn."""


@dataclass(frozen=True)
class Sparsification:
    """A sparsification curve and its areas; the errors are error rates in [0, 1], or lengths.

    Areas are integrals over the whole range of shares, (0, 1], of the exact curve, so that a perfect ranking
    has exactly the optimal one. For error rates that is e + (1 - e) ln(1 - e) (Hu & Mordohai, PAMI 2012). Beside
    them the trapezoid over the shares of ``PERCENTAGES`` alone, the figure of LAF-Net's program and of the survey of
    Poggi et al. (PAMI 2021): compare it only with an optimum that was computed the same way.

    Attributes
    ----------
    percentages : shares of the most confident pixels, percent
    errors, best : mean error among them, and that of the best possible ranking
    mean : mean error of all pixels, which is the area of a random ranking
    auc, optimal : areas of ``errors`` and ``best``
    auc_5_100, optimal_5_100 : areas by the trapezoid from 5 to 100 %
    pixels : number of pixels
    """

    percentages: tuple[int, ...]
    errors: tuple[float, ...]
    best: tuple[float, ...]
    mean: float
    auc: float
    optimal: float
    auc_5_100: float
    optimal_5_100: float
    pixels: int

    @property
    def ratio(self) -> float:
        """AUC / optimal: 1 for a perfect ranking; NaN without errors."""
        return self.auc / self.optimal if self.optimal > 0 else math.nan

    @property
    def ause(self) -> float:
        """Area between the curve and the optimal one (Ilg et al., ECCV 2018): 0 is perfect."""
        return self.auc - self.optimal

    @property
    def aurg(self) -> float:
        """Area between the curve and that of a random ranking (Poggi et al., CVPR 2020): more is better."""
        return self.mean - self.auc

    def areas(self) -> dict[str, float]:
        """Return all areas by name."""
        names = ("auc", "optimal", "mean", "ratio", "ause", "aurg", "auc_5_100", "optimal_5_100")
        return {name: getattr(self, name) for name in names}


def sparsification(confidence: NDArray[Any], error: NDArray[Any]) -> Sparsification:
    """Compute the sparsification curve of one confidence measure; see :func:`sparsifications`."""
    return sparsifications({"": confidence}, {"": error})["", ""]


def sparsifications(
    confidences: Mapping[str, NDArray[Any]], errors: Mapping[str, NDArray[Any]]
) -> dict[tuple[str, str], Sparsification]:
    """Compute the sparsification curves of confidence measures, each for every kind of error.

    Pixels of equal confidence have no order among themselves: a share that ends inside such a group gets the
    group's mean error for its part, so the curve does not depend on the order of the pixels.

    Parameters
    ----------
    confidences : (N,) higher is more confident, +inf the most; NaN less confident than any number
    errors : (N,) bool, wrong or right; or float, absolute errors

    Raises
    ------
    ValueError
        The lengths differ, or there is no pixel.
    """
    shapes = {array.shape for array in (*confidences.values(), *errors.values())}
    if any(len(shape) != 1 or not shape[0] for shape in shapes) or len(shapes) > 1:
        raise ValueError(f"want (N,) arrays of one length N > 0, got {sorted(shapes)}")
    amounts = {name: error.astype(np.float64) for name, error in errors.items()}
    best = {name: _curve(_groups(-amount), amount) for name, amount in amounts.items()}
    made = {}
    for confidence, values in confidences.items():
        groups = _groups(values)
        for name, amount in amounts.items():
            (curve, auc), (lowest, optimal) = _curve(groups, amount), best[name]
            made[confidence, name] = Sparsification(
                percentages=PERCENTAGES,
                errors=tuple(curve.tolist()),
                best=tuple(lowest.tolist()),
                mean=float(amount.mean()),
                auc=auc,
                optimal=optimal,
                auc_5_100=float(np.trapezoid(curve, dx=0.05)),
                optimal_5_100=float(np.trapezoid(lowest, dx=0.05)),
                pixels=int(amount.size),
            )
    return made


def _groups(confidence: NDArray[Any]) -> NDArray[np.intp]:
    """Number of every pixel's group of equal confidence, the most confident first."""
    # numpy sorts NaN behind everything and takes all of them for one value.
    return np.unique(-confidence.astype(np.float64), return_inverse=True)[1]


def _curve(group: NDArray[np.intp], error: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Mean error at ``PERCENTAGES``, and its integral over all shares in (0, 1]."""
    n = error.size
    share = np.append(0, np.cumsum(np.bincount(group))) / n
    total = np.append(0.0, np.cumsum(np.bincount(group, weights=error))) / n
    at = np.array(PERCENTAGES) / 100
    # Within a group the total is a + b p, so that the mean error is a / p + b (and a = 0 in the first).
    slope = np.diff(total) / np.diff(share)
    offset = total[:-1] - slope * share[:-1]
    area = total[-1] + float(np.sum(offset[1:] * np.log(share[2:] / share[1:-1])))
    return np.interp(at, share, total) / at, float(area)
