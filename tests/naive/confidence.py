"""Slow, obvious references of the confidence measures, curve by curve. Never imports depthcli."""

import math

import numpy as np

from tests.naive.stereo import winners


def curve(costs, n, deviation, eps):
    """Measures of one curve; only the first n entries count."""
    c = [float(v) for v in costs[:n]]
    d1 = c.index(min(c))
    c1 = c[d1]
    others = [v for k, v in enumerate(c) if k != d1]
    c2 = min(others) if others else c1
    c2m, second = max(c), -1
    for k in valleys(c):
        if k != d1 and (second < 0 or c[k] < c2m):
            c2m, second = c[k], k
    if n == 1:
        left = right = c1
    else:
        left = c[d1 - 1] if d1 > 0 else c[d1 + 1]
        right = c[d1 + 1] if d1 + 1 < n else c[d1 - 1]
    t = [(v - c1) / deviation for v in c]
    p = [math.exp(-4 * v) for v in t]
    p = [v / sum(p) for v in p]
    smooth = [c[max(k - 1, 0)] + 2 * c[k] + c[min(k + 1, n - 1)] for k in range(n)]
    measures = {
        "msm": -c1, "cur": left + right - 2 * c1, "mm": c2m - c1, "mmn": c2 - c1,
        "pkr": (c2m + eps) / (c1 + eps), "pkrn": (c2 + eps) / (c1 + eps),
        "wmn": (c2m - c1) / (sum(c) + eps), "wmnn": (c2 - c1) / (sum(c) + eps),
        "mlm": 1 / sum(math.exp(-2 * v) for v in t), "aml": 1 / sum(math.exp(-8 * v * v) for v in t),
        "nem": sum(v * math.log(v) for v in p if v > 0), "noi": -len(valleys(smooth)),
    }  # fmt: skip
    return measures, d1, second


def valleys(c):
    """Places below their left neighbor and not above their right one; the ends count."""
    before = [math.inf, *c[:-1]]
    after = [*c[1:], math.inf]
    return [k for k in range(len(c)) if c[k] < before[k] and c[k] <= after[k]]


def spread(costs, valid):
    """(mean, standard deviation) of the valid cells of (N, K) costs."""
    cells = np.concatenate([np.asarray(c[:n], float) for c, n in zip(costs, valid, strict=True)])
    return cells.mean(), cells.std()


def right_view(costs):
    """(H, W) disparity and cost of the right view's winners; the smaller disparity wins ties."""
    chosen = winners(costs)[1]
    rows, columns = np.indices(chosen.shape)
    return chosen, costs[rows, columns + chosen, chosen].astype(float)


def left_right(costs, eps):
    """LRC and LRD of a volume."""
    height, width, n_disparities = costs.shape
    chosen, cheapest = right_view(costs)
    lrc, lrd = np.zeros((height, width)), np.zeros((height, width))
    for y, x in np.ndindex(height, width):
        c = [float(v) for v in costs[y, x, : min(n_disparities, x + 1)]]
        d = c.index(min(c))
        others = c[:d] + c[d + 1 :]
        margin = (min(others) if others else c[d]) - c[d]
        lrc[y, x] = -abs(d - chosen[y, x - d])
        lrd[y, x] = margin / (c[d] - cheapest[y, x - d] + eps)
    return lrc, lrd


def agreement(winner, radius, right=None):
    """Share of the window within 1 of the center; of the right view's window around the match, if that is given."""
    out = np.zeros(winner.shape)
    for y, x in np.ndindex(winner.shape):
        u = x if right is None else x - winner[y, x]
        view = winner if right is None else right
        window = view[max(0, y - radius) : y + radius + 1, max(0, u - radius) : u + radius + 1]
        out[y, x] = np.mean(np.abs(window.astype(int) - int(winner[y, x])) <= 1)
    return out


def average_peak_ratio(costs, winner, second, eps, radius):
    """Mean peak ratio of the window at the center's two disparities; 1 without a second minimum."""
    height, width, _ = costs.shape
    out = np.ones((height, width))
    for y, x in np.ndindex(height, width):
        a, b = winner[y, x], second[y, x]
        if b < 0:
            continue
        window = costs[max(0, y - radius) : y + radius + 1, max(0, x - radius, a, b) : x + radius + 1].astype(float)
        out[y, x] = np.mean((window[..., b] + eps) / (window[..., a] + eps))
    return out
