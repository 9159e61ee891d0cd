"""Sequential tree-reweighted message passing on pixel grids where every pixel has its own candidate values."""

from __future__ import annotations

import numpy as np

from depthcli.core.maps import Floats, Ints, Mask
from depthcli.kernels.jit import empty, helper, jit, run_bands, zeros

_BAND = 24  # rows that a task visits in order; any number is valid, this one keeps all cores busy


def trws(
    values: Floats,
    unary: Floats,
    active: Mask,
    weights: Floats,
    truncation: float,
    iterations: int = 10,
) -> Ints:
    """Choose one candidate per pixel so that ``sum unary + sum weight min(|v_p - v_q|, truncation)`` is small.

    The pairs (p, q) are neighbors among the active pixels: eight per pixel, or four if the weights of the diagonals
    are 0. Method: Kolmogorov, "Convergent tree-reweighted message passing for energy minimization", PAMI 2006. Rows are
    divided into bands, which run in parallel. The last row of each band is visited after all other rows, so that the
    result does not depend on the number of threads.

    Parameters
    ----------
    values : (N, K) candidates of the N active pixels in raster order
    unary : (N, K) costs; inf marks the end of a pixel's candidates. The first cost is finite
    active : (H, W) bool, N of them True
    weights : (N, 4) >= 0, for the neighbors on the right, below left, below, and below right; ignored for neighbors
        that are not active
    truncation : difference of two values beyond which the cost of a pair no longer grows
    iterations : number of forward and backward passes

    Returns the (N,) indices of the chosen candidates.
    """
    count = int(np.count_nonzero(active))
    if count == 0:
        return np.empty(0, np.int32)
    height, width = active.shape
    nodes = np.full((height + 2, width + 2), -1, np.int32)
    nodes[1:-1, 1:-1][active] = np.arange(count, dtype=np.int32)
    choices = np.where(np.isfinite(unary).all(axis=1), values.shape[1], np.argmin(np.isfinite(unary), axis=1))
    choices = choices.astype(np.int32)
    values, unary = np.ascontiguousarray(values), np.ascontiguousarray(unary)
    weights = np.ascontiguousarray(weights)
    share, earlier = _order(nodes, count)
    messages = np.zeros((count, 4, values.shape[1]), np.float32)
    cap, n_bands = np.float32(truncation), -(-height // _BAND)
    for _ in range(iterations):
        for backward in range(2):
            for last in (1, 0) if backward else (0, 1):
                run_bands(
                    _pass, n_bands, nodes, values, unary, weights, cap, choices, share, earlier, messages, backward,
                    last,
                )  # fmt: skip
    labels = np.zeros(count, np.int32)
    for last in range(2):
        run_bands(_select, n_bands, nodes, values, unary, weights, cap, choices, earlier, messages, labels, last)
    return labels


# Neighbor k of a pixel has the offset (_DY[k], _DX[k]). Pair k < 4 is stored with the pixel, pair k >= 4 with the
# neighbor, as its pair k - 4.
_DY = np.array([0, 1, 1, 1, 0, -1, -1, -1])
_DX = np.array([1, -1, 0, 1, -1, 1, 0, -1])


@helper
def _rank(y, height):
    # Return the turn in which a row is visited. Rows of different bands may share a turn, but neighbors do not.
    row = y % _BAND
    return _BAND if row == _BAND - 1 and y != height - 1 else row


@jit
def _order(nodes, count):
    # Return the share of a node's cost for each of its trees, (N,), and bits of the neighbors visited before it, (N,).
    height, width = nodes.shape[0] - 2, nodes.shape[1] - 2
    share = empty(count, np.float32)
    earlier = zeros(count, np.uint8)
    for y in range(height):
        for x in range(width):
            n = nodes[y + 1, x + 1]
            if n < 0:
                continue
            n_earlier, n_later = 0, 0
            for k in range(8):
                if nodes[y + 1 + _DY[k], x + 1 + _DX[k]] < 0:
                    continue
                first = k == 4 if _DY[k] == 0 else _rank(y + _DY[k], height) < _rank(y, height)
                if first:
                    n_earlier += 1
                    earlier[n] |= np.uint8(1 << k)
                else:
                    n_later += 1
            share[n] = np.float32(1.0) / np.float32(max(n_earlier, n_later, 1))
    return share, earlier


@helper
def _visit(
    y, x, n, send_to_earlier, nodes, values, unary, weights, truncation, choices, share, earlier, messages, belief
):
    # Update the messages from pixel (y, x), node n, to its earlier or later neighbors.
    labels = choices[n]
    for i in range(labels):
        belief[i] = unary[n, i]
    for k in range(8):
        m = nodes[y + 1 + _DY[k], x + 1 + _DX[k]]
        if m >= 0:
            message = messages[n, k] if k < 4 else messages[m, k - 4]
            for i in range(labels):
                belief[i] += message[i]
    lowest = belief[0]
    for i in range(1, labels):
        lowest = min(lowest, belief[i])
    for i in range(labels):
        belief[i] -= lowest
    part = share[n]
    for k in range(8):
        m = nodes[y + 1 + _DY[k], x + 1 + _DX[k]]
        if m < 0 or ((earlier[n] >> k) & 1) != send_to_earlier:
            continue
        message = messages[n, k] if k < 4 else messages[m, k - 4]
        weight = weights[n, k] if k < 4 else weights[m, k - 4]
        cap = weight * truncation
        own = np.float32(np.inf)
        for i in range(labels):
            message[i] = part * belief[i] - message[i]
            own = min(own, message[i])
        others = choices[m]
        # The new message overwrites the old one, so it is first computed in scratch memory.
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


@jit
def _pass(begin, end, nodes, values, unary, weights, truncation, choices, share, earlier, messages, backward, last):
    # A forward (0) or backward (1) pass over the rows that are visited ``last`` (1), or over all others (0).
    height, width = nodes.shape[0] - 2, nodes.shape[1] - 2
    for band in range(begin, end):
        belief = empty(2 * values.shape[1], np.float32)
        start, stop = band * _BAND, min(band * _BAND + _BAND, height)
        for i in range(stop - start):
            y = stop - 1 - i if backward else start + i
            if (_rank(y, height) == _BAND) != last:
                continue
            for j in range(width):
                x = width - 1 - j if backward else j
                n = nodes[y + 1, x + 1]
                if n >= 0:
                    _visit(
                        y, x, n, backward, nodes, values, unary, weights, truncation, choices, share, earlier,
                        messages, belief,
                    )  # fmt: skip


@jit
def _select(begin, end, nodes, values, unary, weights, truncation, choices, earlier, messages, labels, last):
    # Choose labels in the order of the visits, from the labels of earlier and the messages of later neighbors.
    height, width = nodes.shape[0] - 2, nodes.shape[1] - 2
    for band in range(begin, end):
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
                        m = nodes[y + 1 + _DY[k], x + 1 + _DX[k]]
                        if m < 0:
                            continue
                        if (earlier[n] >> k) & 1:
                            weight = weights[n, k] if k < 4 else weights[m, k - 4]
                            cost += weight * min(abs(values[n, i] - values[m, labels[m]]), truncation)
                        else:
                            cost += messages[n, k, i] if k < 4 else messages[m, k - 4, i]
                    if cost < lowest:
                        lowest = cost
                        labels[n] = i
