"""Slow twins of the registration confidence, numpy only."""

import itertools

import numpy as np


def displacements(shape, radius, span):
    """Every displacement by length, zero first; none along axes of one voxel."""
    sides = [range(-radius, radius + 1) if n > 1 else range(1) for n in shape]
    most = {"cube": 3, "planes": 2, "axes": 1}[span]
    found = [d for d in itertools.product(*sides) if sum(v != 0 for v in d) <= most]
    return sorted(found, key=lambda d: sum(v * v for v in d))


def curves(fixed, warped, radius, half, span):
    """(K, Z, Y, X) mean absolute differences over channels and window, borders repeated, in stored units."""
    shape = fixed.shape[1:]
    window = list(itertools.product(*(range(-half, half + 1) if n > 1 else range(1) for n in shape)))
    margin = radius + half
    one, other = (np.pad(v.astype(int), [(0, 0), *[(margin, margin)] * 3], mode="edge") for v in (fixed, warped))

    def at(volume, offset):
        places = (slice(margin + o, margin + o + n) for o, n in zip(offset, shape, strict=True))
        return volume[(slice(None), *places)]

    costs = []
    for d in displacements(shape, radius, span):
        total = np.zeros(shape)
        for u in window:
            total += np.abs(at(one, u) - at(other, np.add(u, d))).sum(axis=0)
        costs.append(total / (len(window) * fixed.shape[0]))
    return np.array(costs)


def measures(costs, offsets, spacing, power):
    """What the formulas say, one curve at a time."""
    names = ("eshift", "vshift", "shift", "mlm0", "aml0", "variance", "border", "rank0", "cur0", "cost0", "msm")
    names = (*names, "mlm", "aml", "pkr")
    out = {name: np.zeros(costs.shape[1:]) for name in names}
    offsets = np.array(offsets, float)
    lengths = np.linalg.norm(offsets, axis=1) * spacing
    near = np.isclose((offsets**2).sum(axis=1), 1)
    for p in np.ndindex(*costs.shape[1:]):
        c = costs[(slice(None), *p)]
        s = c.std()
        t = (c - c.min()) / s if s > 1e-9 else None
        if t is None:
            values, stereo = (0, 0, 0, 1, 1, 0), (0, 0)
        else:
            sharp, soft, squared = np.exp(-2 * power * t), np.exp(-2 * t), np.exp(-8 * t * t)
            q = sharp / sharp.sum()
            mean = (q[:, None] * offsets).sum(axis=0) * spacing
            values = (
                (q * lengths).sum(), np.linalg.norm(mean), lengths[c.argmin()], soft[0] / soft.sum(),
                squared[0] / squared.sum(), (q * lengths**2).sum() - (mean**2).sum(),
            )  # fmt: skip
            stereo = (1 / soft.sum(), 1 / squared.sum())
        at_border = abs(offsets[c.argmin()]).max() == offsets.max()
        rest = (at_border, (c < c[0]).mean(), (c[near] - c[0]).sum(), c[0], -c.min())
        for name, value in zip(names, (*values, *rest, *stereo, peak_ratio(c, offsets)), strict=True):
            out[name][p] = value
    return out


def peak_ratio(curve, offsets):
    """(second smallest local minimum + eps) / (smallest cost + eps), eps a thousandth of the mean cost."""
    cost = {tuple(int(v) for v in d): c for d, c in zip(offsets, curve, strict=True)}
    best = min(cost, key=lambda d: (cost[d], sum(v * v for v in d)))
    rivals = []
    for d, c in cost.items():
        around = [(step, cost.get(tuple(np.add(d, step).tolist()))) for step in itertools.product((-1, 0, 1), repeat=3)]
        low = all(other is None or (c < other if step < (0, 0, 0) else c <= other) for step, other in around)
        if low and d != best:
            rivals.append(c)
    eps = 1e-3 * curve.mean() or 1e-3
    return (min(rivals, default=curve.max()) + eps) / (cost[best] + eps)
