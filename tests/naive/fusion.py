"""Slow, obvious references of fusion. Never imports depthcli."""

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


def consensus_weights(shares, exponent):
    """(M, H, W) weights proportional to a power of the shares."""
    powered = np.maximum(shares, 1e-4) ** exponent
    return powered / powered.sum(axis=0)
