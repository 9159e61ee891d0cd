"""Cost curves and their statistics, the input of most measures; one pass over the curves computes all statistics."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.core.maps import Floats, Ints
from depthcli.kernels.exponential import attainable_likelihood, bits_float, float_bits, likelihood
from depthcli.kernels.jit import empty, helper, jit, run_bands
from depthcli.kernels.winners import winners

_LAST = np.int32(0x7FFFFFFF)
_FAR = np.float32(1e30)


@dataclass(frozen=True)
class CurveStatistics:
    """Statistics of curves; arrays have the curves' shape and are float32 unless stated otherwise."""

    lowest: Floats  # smallest cost, c1
    second_lowest: Floats  # next smallest cost anywhere, c2; c1 in a curve of one entry
    # second smallest local minimum, c2m; the largest cost if there is no second one. A local minimum is below its left
    # neighbor and not above its right neighbor; costs beyond the ends of the curve count as infinite
    second_minimum: Floats
    total: Floats  # sum of the costs
    curvature: Floats  # c(d1 - 1) + c(d1 + 1) - 2 c1, mirrored at the ends
    # likelihood of d1: 1 / sum of exp(-2 (c - c1) / s); s is the standard deviation of all valid cells
    likelihood: Floats
    attainable_likelihood: Floats  # likelihood of d1: 1 / sum of exp(-8 ((c - c1) / s)^2)
    negative_entropy: Floats  # sum of p log p, p = softmax(-4 c / s)
    n_minima: Floats  # number of local minima of the curve smoothed by (1, 2, 1) / 4
    winner: Ints  # int32, d1, the first of equal costs
    second_winner: Ints  # int32, d2m, index of the second smallest local minimum; -1 if there is none
    eps: float  # 1e-3 of the mean cost, keeps denominators of ratios above zero


class CostCurves:
    """Cost curves over any search space.

    Parameters
    ----------
    costs : (..., K) uint8, uint16 or float32, finite, lower is better
    valid : (...) integers in 1 .. K; only the first ``valid`` entries of a curve count. Default: all
    """

    def __init__(self, costs: NDArray[Any], valid: NDArray[Any] | None = None) -> None:
        if costs.ndim < 2 or costs.shape[-1] < 1:
            raise ValueError(f"expected costs (..., K) with K >= 1, got {costs.shape}")
        self.costs = costs
        self.valid = np.broadcast_to(costs.shape[-1] if valid is None else valid, costs.shape[:-1]).astype(np.int32)
        if self.valid.size and not 1 <= self.valid.min() <= self.valid.max() <= costs.shape[-1]:
            raise ValueError(f"valid entries must be in 1 .. {costs.shape[-1]}")

    @cached_property
    def statistics(self) -> CurveStatistics:
        """The statistics of all curves."""
        shape = self.costs.shape[:-1]
        rows = self.costs.reshape(-1, *self.costs.shape[-2:])
        counts = self.valid.reshape(rows.shape[:2])
        sums = np.empty((rows.shape[0], 2))
        run_bands(_moments, len(rows), rows, counts, sums)
        mean, square = (float(v) for v in sums.sum(axis=0) / max(1, int(counts.sum(dtype=np.int64))))
        deviation = float(np.sqrt(max(square - mean * mean, 0.0)))
        if deviation <= 1e-6 * abs(mean):  # all costs are equal, except for rounding
            deviation = 1.0
        planes = np.empty((9, *rows.shape[:2]), np.float32)
        winner, second = (np.empty(rows.shape[:2], np.int32) for _ in range(2))
        run_bands(_measure_curves, len(rows), rows, counts, np.float32(1.0 / deviation), planes, winner, second)
        eps = float(np.float32(1e-3 * abs(mean) or 1e-3))
        known: Any = [*(array.reshape(shape) for array in (*planes, winner, second)), eps]
        return CurveStatistics(*known)

    @cached_property
    def stereo_winners(self) -> tuple[NDArray[np.uint16], NDArray[np.uint16]]:
        """The disparities of smallest cost in the left and the right view of a stereo volume, (H, W) each.

        Entries with d > x are left out, regardless of ``valid``.
        """
        return winners(self.costs)


@helper
def _key(value):
    # Return an int32 that sorts like the float: a minimum of integers vectorizes, a minimum of floats does not.
    bits = float_bits(value)
    return np.int32(bits ^ np.int32((bits >> np.int32(31)) & np.int32(0x7FFFFFFF)))


@helper
def _value(key):
    return bits_float(np.int32(key ^ np.int32((key >> np.int32(31)) & np.int32(0x7FFFFFFF))))


@jit
def _moments(begin, end, costs, valid, sums):
    """Write the sum and the sum of squares of the valid cells of (R, C, K) costs; ``sums`` is (R, 2) float64."""
    for r in range(begin, end):
        total = 0.0
        squares = 0.0
        for i in range(costs.shape[1]):
            curve = costs[r, i, : valid[r, i]]
            part = np.float32(0.0)
            part_squares = np.float32(0.0)
            for k in range(curve.size):
                v = np.float32(curve[k])
                part += v
                part_squares += v * v
            total += np.float64(part)
            squares += np.float64(part_squares)
        sums[r, 0] = total
        sums[r, 1] = squares


@jit
def _measure_curves(begin, end, costs, valid, rate, planes, winner, second):
    # Write the statistics of (R, C, K) curves; ``rate`` is 1 / standard deviation of all costs, and ``planes``
    # (9, R, C) are in the order of the fields of CurveStatistics.
    _, columns, n_entries = costs.shape
    padded = (n_entries + 15) // 16 * 16
    for r in range(begin, end):
        z = empty(padded, np.float32)
        key = empty(padded + 2, np.int32)
        smooth = empty(n_entries + 2, np.float32)
        for i in range(columns):
            n = valid[r, i]
            length = (n + 15) // 16 * 16
            curve = costs[r, i, :n]
            values = z[:n]
            keys = key[1 : n + 1]
            total = np.float32(0.0)
            for k in range(values.size):
                values[k] = np.float32(curve[k])
                keys[k] = _key(values[k])
                total += values[k]
            z[n:length] = _FAR
            key[0] = _LAST
            key[n + 1 : length + 2] = _LAST

            own = key[1 : length + 1]
            before = key[:length]
            after = key[2 : length + 2]
            lowest: Any = _LAST
            for k in range(own.size):
                lowest = min(lowest, own[k])
            place: Any = np.int32(length)
            for k in range(own.size):
                place = min(place, np.int32(k) if own[k] == lowest else np.int32(length))
            next_lowest: Any = _LAST
            next_valley: Any = _LAST
            highest: Any = np.int32(-0x7FFFFFFF)
            for k in range(own.size):
                v = own[k] if np.int32(k) != place else _LAST
                next_lowest = min(next_lowest, v)
                valley = (own[k] < before[k]) & (own[k] <= after[k])
                next_valley = min(next_valley, v if valley else _LAST)
                highest = max(highest, own[k] if own[k] != _LAST else np.int32(-0x7FFFFFFF))
            c1: Any = _value(lowest)
            c2: Any = _value(next_lowest) if n > 1 else c1
            c2m: Any = _value(next_valley if next_valley != _LAST else highest)
            other = np.int32(-1)
            if next_valley != _LAST:
                for k in range(n):
                    if own[k] == next_valley and k != place and own[k] < before[k] and own[k] <= after[k]:
                        other = np.int32(k)
                        break
            winner[r, i] = place
            second[r, i] = other

            # t is the distance to the minimum in standard deviations. MLM and NEM use powers of one exponential:
            # exp(-2 t) and exp(-4 t). Large t are clipped, so that nothing becomes denormal.
            likelihoods = np.float32(0.0)
            partition = np.float32(0.0)
            moment = np.float32(0.0)
            attainable = np.float32(0.0)
            cells = z[:length]
            for k in range(cells.size):
                t = min((cells[k] - c1) * rate, np.float32(20.0))
                squared = likelihood(t)
                fourth = squared * squared
                likelihoods += squared
                partition += fourth
                moment += fourth * np.float32(4.0) * t
                attainable += attainable_likelihood(t)

            left = z[place - 1] if place > 0 else (z[place + 1] if n > 1 else c1)
            right = z[place + 1] if place + 1 < n else (z[place - 1] if n > 1 else c1)

            # Binomial smoothing before counting valleys; the ends are repeated.
            inner = smooth[1 : n + 1]
            inner[0] = np.float32(3.0) * z[0] + (z[1] if n > 1 else z[0])
            if n > 1:
                inner[n - 1] = np.float32(3.0) * z[n - 1] + z[n - 2]
                middle = smooth[2:n]
                a, b, c = z[: n - 2], z[1 : n - 1], z[2:n]
                for k in range(middle.size):
                    middle[k] = a[k] + np.float32(2.0) * b[k] + c[k]
            smooth[0] = np.float32(4.0) * _FAR
            smooth[n + 1] = np.float32(4.0) * _FAR
            previous, following = smooth[:n], smooth[2 : n + 2]
            valleys = np.int32(0)
            for k in range(inner.size):
                valleys += np.int32((inner[k] < previous[k]) & (inner[k] <= following[k]))

            planes[0, r, i] = c1
            planes[1, r, i] = c2
            planes[2, r, i] = c2m
            planes[3, r, i] = total
            planes[4, r, i] = left + right - np.float32(2.0) * c1
            planes[5, r, i] = np.float32(1.0) / likelihoods
            planes[6, r, i] = np.float32(1.0) / attainable
            planes[7, r, i] = -moment / partition - np.log(partition)
            planes[8, r, i] = np.float32(valleys)
