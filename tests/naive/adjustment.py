"""Slow references for the adjustment of a right image. Never imports depthcli."""

import numpy as np


def polynomial(c, u, v):
    return c[0] + c[1] * u + c[2] * v + c[3] * u * u + c[4] * u * v + c[5] * v * v


def catmull_rom(samples, t):
    weights = np.array([-t + 2 * t**2 - t**3, 2 - 5 * t**2 + 3 * t**3, t + 4 * t**2 - 3 * t**3, -(t**2) + t**3])
    return float(weights @ np.asarray(samples, float)) / 2


def resampled(image, rows, gains, cell, top):
    """Return (H, W, C) ``image`` shifted along the columns, times gains interpolated between the centers of cells.

    Gains below 1 rise to 1 from 92 to 99 % of ``top``.
    """
    height, width = image.shape[:2]
    out = np.zeros(image.shape)
    for y, x, c in np.ndindex(image.shape):
        at = y + polynomial(rows, 2 * x / width - 1, 2 * y / height - 1)
        first = int(np.floor(at))
        column = [image[min(max(first + k, 0), height - 1), x, c] for k in (-1, 0, 1, 2)]
        i = min(max((y + 0.5) / cell - 0.5, 0), gains.shape[0] - 1)
        j = min(max((x + 0.5) / cell - 0.5, 0), gains.shape[1] - 1)
        i0, j0 = int(i), int(j)
        i1, j1 = min(i0 + 1, gains.shape[0] - 1), min(j0 + 1, gains.shape[1] - 1)
        upper = (1 - j + j0) * gains[i0, j0, c] + (j - j0) * gains[i0, j1, c]
        lower = (1 - j + j0) * gains[i1, j0, c] + (j - j0) * gains[i1, j1, c]
        value, gain = catmull_rom(column, at - first), (1 - i + i0) * upper + (i - i0) * lower
        if gain < 1:
            gain = np.interp(value / top, [0.92, 0.99], [gain, 1])
        out[y, x, c] = value * gain
    return out


def difference_sums(disparity, left, right, cell):
    """Return (2, h, w): mean difference of the matches' channels, and their number, a pixel of a cell."""
    sums = np.zeros((2, *(-(-side // cell) for side in disparity.shape)))
    for y, x in zip(*np.nonzero(~np.isnan(disparity)), strict=True):
        u = max(x - int(disparity[y, x] + 0.5), 0)
        difference = np.abs(left[y, x].astype(float) - right[y, u]).mean()
        sums[:, y // cell, x // cell] += np.array([difference, 1]) / cell**2
    return sums


def light_sums(disparity, left, right, gains, max_ratio, cell, offset):
    """Return (3, h, w, 3): left and right levels of the matches that are no outliers, and their number, per pixel of a
    cell.
    """
    sums = np.zeros((3, *gains.shape))
    for y, x in zip(*np.nonzero(~np.isnan(disparity)), strict=True):
        u = max(x - int(disparity[y, x] + 0.5), 0)
        for c in range(3):
            left_level, right_level = float(left[y, x, c]), float(right[y, u, c])
            ratio = (left_level + offset) / ((right_level + offset) * gains[y // cell, u // cell, c])
            if 1 / max_ratio < ratio < max_ratio:
                sums[:, y // cell, u // cell, c] += np.array([left_level, right_level, 1]) / cell**2
    return sums


def block_sums(disparity, left, right, rows, block, edge, outlier):
    """Return (8, h, w); ``left`` and ``right`` are (grey levels, slopes along x, slopes along y)."""
    height, width = disparity.shape
    sums = np.zeros((8, -(-height // block), -(-width // block)))

    def between(image, v, u, t, part):
        corners = image[v : v + 2, u : u + 2].astype(float)
        return np.array([1 - t, t]) @ corners @ np.array([1 - part, part])

    for y, x in zip(*np.nonzero(~np.isnan(disparity)), strict=True):
        at = x - float(disparity[y, x])
        if at < 0 or at >= width - 1:
            continue
        u = int(at)
        below = y + polynomial(rows, 2 * at / width - 1, 2 * y / height - 1)
        below = min(max(below, 1), height - 3)
        v = min(int(below), height - 4)
        t, part = below - v, at - u
        one, other = (catmull_rom(right[0][v - 1 : v + 3, column], t) for column in (u, u + 1))
        residual = float(left[0][y, x]) - ((1 - part) * one + part * other)
        cell = sums[:, y // block, x // block]
        cell[7] += np.log(1 + (min(abs(residual), outlier) / edge) ** 2)
        if abs(residual) < outlier:
            weight = 1 / (1 + (residual / edge) ** 2)
            across, down = ((float(left[k][y, x]) + between(right[k], v, u, t, part)) / 2 for k in (1, 2))
            cell[:7] += weight * np.array(
                [1, at, across**2, across * down, down**2, across * residual, down * residual]
            )
    return sums
