"""Slow and obvious references of the kernels of transparent; numpy only."""

import numpy as np


def nearest(rows, columns, at_row, at_column, count, skip_own=False):
    """Indices of the nearest samples, ties in order of index."""
    squared = (rows.astype(int) - at_row) ** 2 + (columns.astype(int) - at_column) ** 2
    order = [k for k in np.lexsort((np.arange(len(rows)), squared)) if not (skip_own and squared[k] == 0)]
    return np.array(order[:count], int)


def robust_fit(rows, columns, values, image, at_row, at_column, noise, neighbors, color_scale, slope, steps,
               skip_own=False):  # fmt: skip
    """Value, standard deviation and confidence of the plane at one pixel; float64."""
    near = nearest(rows, columns, at_row, at_column, neighbors, skip_own)
    if len(near) == 0:
        return np.nan, np.nan, 0.0
    dx, dy = (columns[near] - at_column).astype(float), (rows[near] - at_row).astype(float)
    v = values[near].astype(float)
    reach = max(dx[-1] ** 2 + dy[-1] ** 2, 1.0)
    color = ((image[rows[near], columns[near]].astype(float) - image[at_row, at_column]) ** 2).sum(axis=1)
    w = np.exp(-2 * (dx**2 + dy**2) / reach - color / (2 * color_scale**2)) + 1e-12
    rate = slope / image.shape[1]
    apart = np.hypot(dx[:, None] - dx, dy[:, None] - dy)
    agree = np.abs(v - v[:, None]) <= 2 * noise + (rate * v)[:, None] * apart
    start = v[np.argmax(agree @ w)]
    steep = rate * start
    plane, variance = np.array([start, 0.0, 0.0]), 1.0
    design = np.stack([np.ones_like(dx), dx, dy], axis=1)
    for step in range(steps):
        gate = noise * (6 - 3 * step / max(1, steps - 1)) + (steep * np.hypot(dx, dy) if step == 0 else 0)
        u = (v - design @ plane) / gate
        f = np.where(np.abs(u) < 1, w * (1 - u**2) ** 2, 0)
        if f.sum() <= 1e-9 * w.sum():
            break
        normal = design.T @ (f[:, None] * design) + np.diag([0, 1, 1]) * (noise / steep) ** 2
        plane = np.linalg.solve(normal, design.T @ (f * v))
        variance = np.linalg.inv(normal)[0, 0]
    inside = np.abs(v - design @ plane) <= 3 * noise
    away = (w * inside * np.hypot(dx, dy)).sum() / ((w * inside).sum() + 1e-12)
    return plane[0], np.sqrt(noise**2 * variance + (steep * away) ** 2), (w * inside).sum() / w.sum()


def faded_costs(costs, left, right):
    """Costs drawn towards the pixel's mean by the smaller share of the two pixels they compare; rounded half up."""
    height, width, n_disparities = costs.shape
    out = np.zeros(costs.shape, np.uint16)
    for y, x in np.ndindex(height, width):
        mean = costs[y, x].astype(float).mean()
        for d in range(n_disparities):
            share = min(left[y, x], right[y, x - d]) if d <= x else left[y, x]
            out[y, x, d] = int(np.floor(mean + share * (costs[y, x, d] - mean) + 0.5))
    return out


def smoothed(values, image, wanted, radius, color_scale):
    """Where wanted, the mean of the known values in a square, weighted by exp(-|dRGB|^2 / (2 scale^2))."""
    height, width = values.shape
    out = values.copy()
    for y, x in np.ndindex(height, width):
        if not wanted[y, x] or np.isnan(values[y, x]):
            continue
        window = np.s_[max(0, y - radius) : y + radius + 1, max(0, x - radius) : x + radius + 1]
        color = ((image[window].astype(float) - image[y, x].astype(float)) ** 2).sum(axis=2)
        weights = np.exp(-color / (2 * color_scale**2)) * np.isfinite(values[window])
        out[y, x] = (weights * np.nan_to_num(values[window])).sum() / weights.sum()
    return out
