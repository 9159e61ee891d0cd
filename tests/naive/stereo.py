"""Slow, obvious numpy twins of the stereo kernels: loops as the papers write them. Never imports depthcli."""

from __future__ import annotations

import numpy as np


def adaptive_weight(costs, left, right, radius, gamma_color, gamma_space, squared=False):
    """Yoon & Kweon's weighted mean in float64; left, right are (H, W, 3) colors as floats.

    Neighbors outside either image are left out; cells with d > x keep their cost.
    """
    height, width, disparities = costs.shape
    out = costs.astype(float)
    for y in range(height):
        for x in range(width):
            for d in range(min(disparities, x + 1)):
                num = den = 0.0
                for yq in range(max(0, y - radius), min(height, y + radius + 1)):
                    for xq in range(max(0, x - radius, d), min(width, x + radius + 1)):
                        color_l = np.sum((left[y, x] - left[yq, xq]) ** 2)
                        color_r = np.sum((right[y, x - d] - right[yq, xq - d]) ** 2)
                        space = (y - yq) ** 2 + (x - xq) ** 2
                        if not squared:
                            color_l, color_r, space = np.sqrt([color_l, color_r, space])
                        weight = np.exp(-((color_l + color_r) / gamma_color + 2 * space / gamma_space))
                        num += weight * costs[yq, xq, d]
                        den += weight
                out[y, x, d] = num / den
    return out
