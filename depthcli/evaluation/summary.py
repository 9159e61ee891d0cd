"""Many scores in few numbers: means, average ranks, paired comparisons."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


def ranks(values: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Rank of every method in every column, 1 = lowest value; equal values share their mean rank.

    Parameters
    ----------
    values : (methods, columns), lower is better; NaN (no result) ranks last

    Returns
    -------
    (methods, columns) float64
    """
    keys = np.where(np.isnan(values), np.inf, values.astype(np.float64))
    lower = (keys[:, None, :] > keys[None, :, :]).sum(axis=1)
    equal = (keys[:, None, :] == keys[None, :, :]).sum(axis=1)
    result: NDArray[np.float64] = lower + (equal + 1) / 2
    return result


def average_ranks(values: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Mean over the columns of :func:`ranks`: the "average rank" of the Middlebury v2 table."""
    if values.shape[1] == 0:
        return np.full(values.shape[0], np.nan)
    mean: NDArray[np.float64] = ranks(values).mean(axis=1)
    return mean


@dataclass(frozen=True)
class Comparison:
    """Method ``b`` against method ``a`` over the scenes that both have.

    Attributes
    ----------
    scenes : number of scenes compared
    wins, losses, ties : scenes where b is lower, higher, equal
    mean_difference : mean of b - a (negative: b is better)
    worst_ratio : largest b / a over the scenes (NaN where a is 0 everywhere)
    p_value : two-sided exact sign test; ties are left out
    """

    scenes: int
    wins: int
    losses: int
    ties: int
    mean_difference: float
    worst_ratio: float
    p_value: float


def compare(a: Sequence[float], b: Sequence[float]) -> Comparison:
    """Compare two methods scene by scene; lower is better, pairs with a NaN are left out.

    Raises
    ------
    ValueError
        The sequences differ in length.
    """
    if len(a) != len(b):
        raise ValueError(f"want two sequences of one length, got {len(a)} and {len(b)}")
    pairs = [(x, y) for x, y in zip(a, b, strict=True) if not (math.isnan(x) or math.isnan(y))]
    wins = sum(y < x for x, y in pairs)
    losses = sum(y > x for x, y in pairs)
    quotients = [y / x for x, y in pairs if x > 0]
    return Comparison(
        scenes=len(pairs),
        wins=wins,
        losses=losses,
        ties=len(pairs) - wins - losses,
        mean_difference=math.fsum(y - x for x, y in pairs) / len(pairs) if pairs else float("nan"),
        worst_ratio=max(quotients) if quotients else float("nan"),
        p_value=sign_test(wins, losses),
    )


def sign_test(wins: int, losses: int) -> float:
    """Two-sided exact p value of the sign test: how likely a split at least so uneven is by chance."""
    n = wins + losses
    if n == 0:
        return 1.0
    tail = sum(math.comb(n, k) for k in range(min(wins, losses) + 1))
    return min(1.0, float(2 * tail / 2**n))
