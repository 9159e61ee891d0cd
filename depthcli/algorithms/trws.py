"""Sequential tree-reweighted message passing on pixel grids where every pixel has its own few candidate values."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from depthcli.kernels.jit import jit, parallel_jit, prange

_BAND = 24  # rows that one task passes through in order


@dataclass(frozen=True)
class ValueLabelling:
    """Result of :func:`trws`.

    Attributes
    ----------
    labels : (N,) int32, index of the chosen candidate
    energy : of ``labels``
    lower_bound : no labelling has less energy (up to rounding)
    """

    labels: NDArray[np.int32]
    energy: float
    lower_bound: float


def trws(
    values: NDArray[np.float32],
    unary: NDArray[np.float32],
    active: NDArray[np.bool_],
    weights: NDArray[np.float32],
    truncation: float,
    iterations: int = 10,
) -> ValueLabelling:
    """Choose one candidate a pixel: ``sum unary + sum weight min(|v_p - v_q|, truncation)`` over neighbor pairs, low.

    Kolmogorov, "Convergent tree-reweighted message passing for energy minimization", PAMI 2006, on the pixels that
    are active, with eight neighbors (four, where the weights of the diagonals are 0). Pixels are visited band by
    band: rows 0 of all bands of rows, rows 1, ..., with the last row of each band after all others. That is an
    order as good as any, and lets the bands run side by side with the same answer at any number of threads.

    Parameters
    ----------
    values : (N, K) float32, candidates of the N active pixels in raster order
    unary : (N, K) float32 costs, inf = no candidate; the first of every pixel must be finite, and none after an
        inf counts
    active : (H, W) bool, N of them True
    weights : (N, 4) float32 >= 0, of the pairs with the neighbor on the right, below left, below, and below right
        (not read where that neighbor is not active)
    truncation : largest cost of a difference
    iterations : passes there and back

    Raises
    ------
    ValueError
        For shapes that do not fit, negative weights, or a pixel without a candidate.
    """
    count = int(np.count_nonzero(active))
    if values.ndim != 2 or len(values) != count or unary.shape != values.shape or weights.shape != (count, 4):
        raise ValueError(
            f"want values and unary (N, K) and weights (N, 4) for N = {count} active pixels, "
            f"got {values.shape}, {unary.shape}, {weights.shape}"
        )
    if iterations < 1 or truncation < 0:
        raise ValueError(f"want iterations >= 1 and truncation >= 0, got {iterations}, {truncation}")
    if count == 0:
        return ValueLabelling(np.empty(0, np.int32), 0.0, 0.0)
    if not (np.isfinite(unary[:, 0]).all() and np.isfinite(values[:, 0]).all()):
        raise ValueError("every active pixel needs a candidate with a finite cost")
    if not (weights >= 0).all():
        raise ValueError("want weights >= 0")
    height, width = active.shape
    nodes = np.full((height + 2, width + 2), -1, np.int32)
    nodes[1:-1, 1:-1][active] = np.arange(count, dtype=np.int32)
    choices = np.where(np.isfinite(unary).all(axis=1), values.shape[1], np.argmin(np.isfinite(unary), axis=1))
    choices = choices.astype(np.int32)
    values, unary = np.ascontiguousarray(values), np.ascontiguousarray(unary)
    weights = np.ascontiguousarray(weights)
    share, before = _order(nodes, count)
    messages = np.zeros((count, 4, values.shape[1]), np.float32)
    cap = np.float32(truncation)
    least = np.zeros(height, np.float64)
    for _ in range(iterations):
        _forward(nodes, values, unary, weights, cap, choices, share, before, messages)
        _backward(nodes, values, unary, weights, cap, choices, share, before, messages, least)
    labels = np.zeros(count, np.int32)
    _select(nodes, values, unary, weights, cap, choices, before, messages, labels)
    return ValueLabelling(labels, _energy(nodes, values, unary, weights, cap, labels), float(least.sum()))


# Neighbor k of a pixel lies at (_DOWN[k], _ACROSS[k]); pair k < 4 is stored with the pixel, pair k >= 4 with the
# neighbor, as its pair k - 4.
_DOWN = np.array([0, 1, 1, 1, 0, -1, -1, -1])
_ACROSS = np.array([1, -1, 0, 1, -1, 1, 0, -1])


@jit
def _rank(y, height):  # type: ignore[no-untyped-def]
    """When a row is visited: rows of different bands may share a rank, but no neighbors do."""
    row = y % _BAND
    return _BAND if row == _BAND - 1 and y != height - 1 else row


@jit
def _order(nodes, count):  # type: ignore[no-untyped-def]
    """Share of a node's cost that each of its trees gets, (N,); which of its neighbors come first, bits (N,)."""
    height, width = nodes.shape[0] - 2, nodes.shape[1] - 2
    share = np.empty(count, np.float32)
    before = np.zeros(count, np.uint8)
    for y in range(height):
        for x in range(width):
            n = nodes[y + 1, x + 1]
            if n < 0:
                continue
            earlier, later = 0, 0
            for k in range(8):
                if nodes[y + 1 + _DOWN[k], x + 1 + _ACROSS[k]] < 0:
                    continue
                first = k == 4 if _DOWN[k] == 0 else _rank(y + _DOWN[k], height) < _rank(y, height)
                if first:
                    earlier += 1
                    before[n] |= np.uint8(1 << k)
                else:
                    later += 1
            share[n] = np.float32(1.0) / np.float32(max(earlier, later, 1))
    return share, before


@jit
def _visit(  # type: ignore[no-untyped-def]
    y, x, n, send_to_earlier, nodes, values, unary, weights, truncation, choices, share, before, messages, belief,
):  # fmt: skip
    """Renew the messages from pixel (y, x), node n, to its earlier or its later neighbors; its least belief."""
    labels = choices[n]
    for i in range(labels):
        belief[i] = unary[n, i]
    for k in range(8):
        m = nodes[y + 1 + _DOWN[k], x + 1 + _ACROSS[k]]
        if m >= 0:
            message = messages[n, k] if k < 4 else messages[m, k - 4]
            for i in range(labels):
                belief[i] += message[i]
    least = belief[0]
    for i in range(1, labels):
        least = min(least, belief[i])
    for i in range(labels):
        belief[i] -= least
    part = share[n]
    total = np.float64(least)
    for k in range(8):
        m = nodes[y + 1 + _DOWN[k], x + 1 + _ACROSS[k]]
        if m < 0 or ((before[n] >> k) & 1) != send_to_earlier:
            continue
        message = messages[n, k] if k < 4 else messages[m, k - 4]
        weight = weights[n, k] if k < 4 else weights[m, k - 4]
        cap = weight * truncation
        own = np.float32(np.inf)
        for i in range(labels):
            message[i] = part * belief[i] - message[i]
            own = min(own, message[i])
        others = choices[m]
        # What is sent has to be worked out before the old message, which shares its place, is overwritten.
        for j in range(others):
            best = own + cap
            for i in range(labels):
                best = min(best, message[i] + weight * abs(values[n, i] - values[m, j]))
            belief[values.shape[1] + j] = best
        lowest = belief[values.shape[1]]
        for j in range(1, others):
            lowest = min(lowest, belief[values.shape[1] + j])
        for j in range(others):
            message[j] = belief[values.shape[1] + j] - lowest
        total += lowest
    return total


@parallel_jit
def _forward(nodes, values, unary, weights, truncation, choices, share, before, messages):  # type: ignore[no-untyped-def]
    height, width = nodes.shape[0] - 2, nodes.shape[1] - 2
    bands = (height + _BAND - 1) // _BAND
    for last in range(2):
        for band in prange(bands):
            belief = np.empty(2 * values.shape[1], np.float32)
            for y in range(band * _BAND, min(band * _BAND + _BAND, height)):
                if (_rank(y, height) == _BAND) == last:
                    for x in range(width):
                        n = nodes[y + 1, x + 1]
                        if n >= 0:
                            _visit(y, x, n, 0, nodes, values, unary, weights, truncation, choices, share, before,
                                   messages, belief)  # fmt: skip


@parallel_jit
def _backward(nodes, values, unary, weights, truncation, choices, share, before, messages, least):  # type: ignore[no-untyped-def]
    """As :func:`_forward`, the other way round; ``least`` (H,) float64: the rows' parts of the lower bound."""
    height, width = nodes.shape[0] - 2, nodes.shape[1] - 2
    bands = (height + _BAND - 1) // _BAND
    for last in range(1, -1, -1):
        for band in prange(bands):
            belief = np.empty(2 * values.shape[1], np.float32)
            for y in range(min(band * _BAND + _BAND, height) - 1, band * _BAND - 1, -1):
                if (_rank(y, height) == _BAND) == last:
                    total = 0.0
                    for x in range(width - 1, -1, -1):
                        n = nodes[y + 1, x + 1]
                        if n >= 0:
                            total += _visit(y, x, n, 1, nodes, values, unary, weights, truncation, choices, share,
                                            before, messages, belief)  # fmt: skip
                    least[y] = total


@parallel_jit
def _select(nodes, values, unary, weights, truncation, choices, before, messages, labels):  # type: ignore[no-untyped-def]
    """Labels in the order of the visits: each given those before it, and the messages of those after it."""
    height, width = nodes.shape[0] - 2, nodes.shape[1] - 2
    bands = (height + _BAND - 1) // _BAND
    for last in range(2):
        for band in prange(bands):
            for y in range(band * _BAND, min(band * _BAND + _BAND, height)):
                if (_rank(y, height) == _BAND) != last:
                    continue
                for x in range(width):
                    n = nodes[y + 1, x + 1]
                    if n < 0:
                        continue
                    lowest = np.float32(np.inf)
                    for i in range(choices[n]):
                        cost = unary[n, i]
                        for k in range(8):
                            m = nodes[y + 1 + _DOWN[k], x + 1 + _ACROSS[k]]
                            if m < 0:
                                continue
                            if (before[n] >> k) & 1:
                                weight = weights[n, k] if k < 4 else weights[m, k - 4]
                                cost += weight * min(abs(values[n, i] - values[m, labels[m]]), truncation)
                            else:
                                cost += messages[n, k, i] if k < 4 else messages[m, k - 4, i]
                        if cost < lowest:
                            lowest = cost
                            labels[n] = i


@jit
def _energy(nodes, values, unary, weights, truncation, labels):  # type: ignore[no-untyped-def]
    total = 0.0
    for y in range(1, nodes.shape[0] - 1):
        for x in range(1, nodes.shape[1] - 1):
            n = nodes[y, x]
            if n < 0:
                continue
            total += unary[n, labels[n]]
            for k in range(4):
                m = nodes[y + _DOWN[k], x + _ACROSS[k]]
                if m >= 0:
                    total += weights[n, k] * min(abs(values[n, labels[n]] - values[m, labels[m]]), truncation)
    return total
