"""Slow, obvious references of fusion, and of the choice among maps and their mixing. Never imports depthcli."""

import itertools

import numpy as np


def squash(costs, scale, outside=None):
    """1 - exp(-C / scale) times 255, rounded; cells with d > x hold the mean of every fourth row's others."""
    width, n_disparities = costs.shape[1:]
    inside = np.arange(n_disparities)[None, :] <= np.arange(width)[:, None]
    sample = costs[::4][:, inside].astype(float)
    if scale is None:
        ordered = np.sort(sample, axis=None)
        scale = ordered[(ordered.size - 1) // 2] if costs.dtype != np.float32 else float(np.median(sample))
        scale = scale if scale > 0 else 1.0
    value = 1 - np.exp(-costs.astype(float) / scale)
    neutral = np.mean(1 - np.exp(-sample / scale)) if outside is None else outside
    value[:, ~inside] = neutral
    return value * 255


def blend(volumes, weights):
    """Weighted mean in 1/256; the largest weight takes what rounding leaves over."""
    fixed = np.floor(weights * np.float32(256) + np.float32(0.5)).astype(int)
    best = fixed.argmax(axis=0)
    for y, x in np.ndindex(best.shape):
        fixed[best[y, x], y, x] += 256 - fixed[:, y, x].sum()
    total = sum(w[:, :, None] * v.astype(int) for w, v in zip(fixed, volumes, strict=True))
    return ((total + 128) >> 8).astype(np.uint8)


def cast_votes(disparities, weights, n_disparities, tolerance, fading):
    """(H, W, D) votes of each pixel alone, divided by the number of voters."""
    voters, height, width = disparities.shape
    votes = np.zeros((height, width, n_disparities))
    for m, y, x in np.ndindex(disparities.shape):
        for d in range(n_disparities):
            off = abs(d - disparities[m, y, x])
            if off <= tolerance:
                fade = 1 - off / (tolerance + 1) if fading else 1
                votes[y, x, d] += fade * round(float(weights[m, y, x]) * 256) / 256 / voters
    return votes


def color_shares(votes, image, reach, softness):
    """Votes filtered forwards and backwards along rows, then columns, over the same of ones."""
    across, down = (_decay(image, axis, reach, softness) for axis in (1, 0))
    ones = np.ones(votes.shape[:2])
    for decay, axis in ((across, 1), (down, 0)):
        votes, ones = _recurse(votes, decay, axis), _recurse(ones, decay, axis)
    return votes / ones[:, :, None]


def _decay(image, axis, reach, softness):
    step = np.abs(np.diff(image.astype(int), axis=axis)).max(axis=2)
    return np.exp(-(1 / reach + step / softness))


def _recurse(values, decay, axis):
    out = np.moveaxis(np.array(values, float), axis, 0).copy()
    steps = np.moveaxis(decay, axis, 0)
    steps = steps.reshape(steps.shape + (1,) * (out.ndim - steps.ndim))
    for i in range(1, len(out)):
        out[i] += steps[i - 1] * out[i - 1]
    for i in range(len(out) - 2, -1, -1):
        out[i] += steps[i] * out[i + 1]
    return np.moveaxis(out, 0, axis)


def curve(costs, value):
    """Cost between two whole disparities."""
    low = min(int(value), len(costs) - 1)
    high = min(low + 1, len(costs) - 1)
    return costs[low] + (value - low) * (float(costs[high]) - float(costs[low]))


def pointwise(maps, costs, scale, right, left_image, right_image):
    """NetworkInputs that look at one row only: name -> (N, H, W)."""
    width = maps.shape[2]
    planes = {
        name: np.zeros(maps.shape)
        for name in ("excess_cost", "right_view_difference", "match_column", "self_occlusion", "color_difference")
    }
    for n, y, x in np.ndindex(maps.shape):
        d = float(maps[n, y, x])
        planes["excess_cost"][n, y, x] = (curve(costs[y, x], d) - costs[y, x].min()) / scale
        planes["match_column"][n, y, x] = np.clip(x - d, -20, 20)
        u = int(np.floor(np.float32(x) - maps[n, y, x] + np.float32(0.5)))
        if u < 0:
            planes["right_view_difference"][n, y, x] = -6
        else:
            planes["right_view_difference"][n, y, x] = np.clip(d - float(right[y, u]), -5, 5)
            nearest = [
                float(maps[n, y, v])
                for v in range(width)
                if int(np.floor(np.float32(v) - maps[n, y, v] + np.float32(0.5))) == u
            ]
            planes["self_occlusion"][n, y, x] = min(max(nearest) - d, 6)
        at = np.clip(x - d, 0, width - 1)
        low, high = int(at), min(int(at) + 1, width - 1)
        warped = right_image[y, low] + (at - int(at)) * (right_image[y, high].astype(float) - right_image[y, low])
        planes["color_difference"][n, y, x] = min(np.abs(left_image[y, x] - warped).max(), 40)
    return planes


def roughness(values, slope):
    """Misfits with the four neighbors, at most two pixels each."""
    out = np.zeros(values.shape)
    height, width = values.shape
    for y, x in np.ndindex(values.shape):
        for dy, dx, axis in ((0, 1, 0), (0, -1, 0), (1, 0, 1), (-1, 0, 1)):
            v, u = y + dy, x + dx
            if not (0 <= v < height and 0 <= u < width):
                continue
            step = (float(values[v, u]) - float(values[y, x])) * (dy + dx)
            both = [abs(step - float(slope[axis, y, x])), abs(step - float(slope[axis, v, u]))]
            out[y, x] += min(2, sum(both) / 2)
    return out


def log_odds(rows, mean, scale, layers):
    """Log odds of (P, N, F) inputs."""
    (w1, b1), (w2, b2), (w3, b3) = layers
    first = np.maximum(np.clip((rows - mean) * scale, -4, 4) @ w1 + b1, 0)
    return (np.maximum(first @ w2 + b2, 0) @ w3 + b3)[..., 0]


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
