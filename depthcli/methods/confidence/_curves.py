"""One pass over cost curves that computes every measure of a single curve."""

from __future__ import annotations

from typing import Any

import numpy as np

from depthcli.kernels.curve import attainable_likelihood, likelihood, peak_ratio
from depthcli.kernels.exponential import bits_float, float_bits
from depthcli.kernels.jit import jit, parallel_jit, prange

# Order of the planes written by `measure_curves`.
CURVE_MEASURES = ("msm", "cur", "pkr", "pkrn", "mm", "mmn", "wmn", "wmnn", "mlm", "aml", "nem", "noi")

_LAST = np.int32(0x7FFFFFFF)
_FAR = np.float32(1e30)


@jit
def _key(value: Any) -> Any:
    # An int32 that sorts as the float does: a minimum of integers vectorizes, one of floats does not.
    bits = float_bits(value)
    return np.int32(bits ^ np.int32((bits >> np.int32(31)) & np.int32(0x7FFFFFFF)))


@jit
def _value(key: Any) -> Any:
    return bits_float(np.int32(key ^ np.int32((key >> np.int32(31)) & np.int32(0x7FFFFFFF))))


@parallel_jit
def moments(costs: Any, valid: Any, sums: Any) -> None:
    """Sum and sum of squares of the valid cells of (R, C, K) costs, one row of (R, 2) float64 each."""
    for r in prange(costs.shape[0]):
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


@parallel_jit
def measure_curves(costs: Any, valid: Any, rate: Any, eps: Any, planes: Any, winner: Any, second: Any) -> None:
    """Write all curve measures.

    Parameters
    ----------
    costs : (R, C, K) any real dtype; valid : (R, C) entries that count, 1 .. K
    rate : 1 / global standard deviation; eps : guards the ratios
    planes : (12, R, C) float32, in the order of CURVE_MEASURES
    winner : (R, C) int32, index of the smallest cost
    second : (R, C) int32, index of the second smallest local minimum, -1 where there is none
    """
    rows, columns, depth = costs.shape
    padded = (depth + 15) // 16 * 16
    for r in prange(rows):
        z = np.empty(padded, np.float32)
        key = np.empty(padded + 2, np.int32)
        smooth = np.empty(depth + 2, np.float32)
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

            # t is the distance to the minimum in standard deviations. MLM and NEM see powers of one exponential:
            # exp(-2 t) and exp(-4 t). Clipped where it no longer matters, so that nothing becomes denormal.
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

            planes[0, r, i] = -c1
            planes[1, r, i] = left + right - np.float32(2.0) * c1
            planes[2, r, i] = peak_ratio(c1, c2m, eps)
            planes[3, r, i] = peak_ratio(c1, c2, eps)
            planes[4, r, i] = c2m - c1
            planes[5, r, i] = c2 - c1
            planes[6, r, i] = (c2m - c1) / (total + eps)
            planes[7, r, i] = (c2 - c1) / (total + eps)
            planes[8, r, i] = np.float32(1.0) / likelihoods
            planes[9, r, i] = np.float32(1.0) / attainable
            planes[10, r, i] = -moment / partition - np.log(partition)
            planes[11, r, i] = -np.float32(valleys)
