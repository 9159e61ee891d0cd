"""Slow references of the mixing of maps."""

import itertools

import numpy as np

from tests.naive.choice import curve


def matching_costs(maps, costs, unit, truncation):
    """Interpolated costs along every map, truncated."""
    out = np.empty(maps.shape)
    for k, y, x in np.ndindex(maps.shape):
        d = maps[k, y, x]
        out[k, y, x] = truncation if int(d) > x else min(curve(costs[y, x], d) * unit, truncation)
    return out


def disagreements(maps, weights):
    """Weighted share of the other maps farther than half a pixel, fading to one and a half."""
    out = np.zeros(maps.shape)
    for k, m in itertools.permutations(range(len(maps)), 2):
        out[k] += weights[m] * (1 - np.clip(1.5 - np.abs(maps[k] - maps[m]), 0, 1)) / (weights.sum() - weights[k])
    return out


def contradictions(maps, right, hidden):
    """1 well in front of what the right view sees, ``hidden`` behind it or outside."""
    out = np.zeros(maps.shape)
    for k, y, x in np.ndindex(maps.shape):
        u = int(np.floor(x - maps[k, y, x] + 0.5))
        nearer = maps[k, y, x] - float(right[y, u]) if u >= 0 else -np.inf
        out[k, y, x] = hidden if nearer < -1 else np.clip(nearer - 1, 0, 1)
    return out


def hidden_jumps(maps, image):
    """Steps of more than a pixel, up to two, to the four neighbors, less where the color changes."""
    out = np.zeros(maps.shape)
    height, width = maps.shape[1:]
    for k, y, x in np.ndindex(maps.shape):
        for v, u in ((y, x - 1), (y, x + 1), (y - 1, x), (y + 1, x)):
            if 0 <= v < height and 0 <= u < width:
                color = np.abs(image[y, x].astype(int) - image[v, u]).max()
                out[k, y, x] += np.clip(abs(maps[k, y, x] - maps[k, v, u]) - 1, 0, 1) * np.exp(-color / 10)
    return out


def energy(values, slopes, cost, weights, truncation):
    """Costs, and misfits of neighbors beyond their slopes."""
    height, width = values.shape
    total = float(cost.sum())
    for y, x in np.ndindex(height, width):
        for axis, (v, u) in enumerate(((y, x + 1), (y + 1, x))):
            if v < height and u < width:
                step = float(values[v, u]) - float(values[y, x])
                misfit = (abs(step - slopes[axis, y, x]) + abs(step - slopes[axis, v, u])) / 2
                total += weights[axis][y, x] * min(truncation, misfit)
    return total
