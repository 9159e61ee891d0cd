"""Slow, obvious versions of the kernels behind plane_votes."""

import numpy as np


def local_plane(disparity, trust, noise, y, x):
    """Value, slopes and residual scale of the plane around one pixel, after three reweightings."""
    rows, columns = np.mgrid[max(y - 4, 0) : y + 5, max(x - 4, 0) : x + 5]
    inside = (rows < disparity.shape[0]) & (columns < disparity.shape[1])
    rows, columns = rows[inside], columns[inside]
    used = ~np.isnan(disparity[rows, columns]) & (trust[rows, columns] > 0)
    rows, columns = rows[used], columns[used]
    fx, fy = (columns - x).astype(float), (rows - y).astype(float)
    v = disparity[rows, columns].astype(float) - disparity[y, x]
    plane = np.zeros(3)
    for step in range(3):
        gate = 4.0 * noise if step else (6.4 + np.maximum(np.abs(fx), np.abs(fy))) * noise
        r = (v - (plane[0] * fx + plane[1] * fy + plane[2])) / gate
        w = trust[rows, columns] * np.maximum(0, 1 - r * r) ** 2
        total = max(w.sum(), 1e-6)
        mx, my, md = ((w * a).sum() / total for a in (fx, fy, v))
        xx, yy = (w * (fx - mx) ** 2).sum() + 1, (w * (fy - my) ** 2).sum() + 1
        xy = (w * (fx - mx) * (fy - my)).sum()
        xd, yd = (w * (fx - mx) * (v - md)).sum(), (w * (fy - my) * (v - md)).sum()
        slopes = np.linalg.solve([[xx, xy], [xy, yy]], [xd, yd]) if total >= 8 else np.zeros(2)
        slopes = np.clip(slopes, -0.7, 0.7)
        plane = np.array([*slopes, md - slopes[0] * mx - slopes[1] * my])
    residual = v - (plane[0] * fx + plane[1] * fy + plane[2])
    return disparity[y, x] + plane[2], plane[0], plane[1], np.sqrt((w * residual**2).sum() / total)


def histogram(pixel, lab, planes, trust, limit, beyond, low, unit, bins, sigma_color, sigma_space):
    """Mass and moment (bins,) of the votes for one pixel: every pixel, every fourth, every twelfth, by distance."""
    y, x = pixel
    mass, moment = np.zeros(bins), np.zeros(bins)
    value, slope_x, slope_y = planes
    for v in range(value.shape[0]):
        for u in range(value.shape[1]):
            far = max(abs(u - x), abs(v - y))
            stride = 1 if far <= 5 else 4 if far <= 36 else 12
            if far > 108 or v % stride or u % stride or not trust[v, u] > 0 or np.isnan(value[v, u]):
                continue
            contrast = np.abs(lab[v, u].astype(int) - lab[y, x]).sum()
            w = trust[v, u] * stride**2 * (np.exp(-contrast / sigma_color) + 0.002)
            w *= np.exp(-(abs(u - x) + abs(v - y)) / sigma_space)
            fade = 1 / (1 + ((u - x) ** 2 + (v - y) ** 2) / 400)
            d = value[v, u] + fade * (slope_x[v, u] * (x - u) + slope_y[v, u] * (y - v))
            k = int((d - low) / unit)
            if 1 <= k < bins - 1:
                w *= beyond[y, x] if d > limit[y, x] else 1
                mass[k] += w
                moment[k] += w * d
    return mass, moment


def modes(mass, moment, most):
    """Values and shares of the modes, the strongest first."""
    mass, moment, total = mass.copy(), moment.copy(), mass.sum()
    found = []
    for _ in range(most):
        smooth = mass.copy()
        smooth[1:-1] += 0.5 * (mass[:-2] + mass[2:])
        top = int(smooth.argmax())
        if smooth[top] <= 0 or smooth[top] < 0.01 * total:
            break
        value = moment[top - 1 : top + 2].sum() / mass[top - 1 : top + 2].sum()
        found.append((value, mass[max(top - 2, 0) : top + 3].sum() / total))
        mass[max(top - 2, 0) : top + 3] = 0
        moment[max(top - 2, 0) : top + 3] = 0
    return found
