"""Joint bilateral filling of gaps: means of known values, weighted by distance and similarity of color."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from depthcli.kernels.jit import parallel_jit, prange


def joint_bilateral_fill(
    color: NDArray[np.uint8],
    values: NDArray[np.float32],
    window: int = 21,
    sigma_space: float = 5.0,
    sigma_color: float = 15.0,
) -> NDArray[np.float32]:
    """Fill unknown values with ``sum w v / sum w`` over the known values in a window, from the edges of gaps inwards.

    ``w = exp(-|p - q|^2 / 2 sigma_space^2 - |I_p - I_q|^2 / 2 sigma_color^2)``. Filled values count as known in
    the next round; pixels that no round can fill stay NaN.

    Parameters
    ----------
    color : (H, W, 3) uint8
    values : (H, W) float32, NaN = unknown
    window : side of the window, pixels, odd
    sigma_space : pixels
    sigma_color : grey levels

    Returns
    -------
    (H, W) float32
    """
    reach = window // 2
    offsets = np.arange(-reach, reach + 1)
    spatial = np.exp(-(offsets[:, None] ** 2 + offsets**2) / (2 * sigma_space**2)).astype(np.float32)
    likeness = np.exp(-np.arange(3 * 255**2 + 1) / (2 * sigma_color**2)).astype(np.float32)
    filled = values.copy()
    unknown = np.argwhere(np.isnan(filled))
    while unknown.size:
        means = _bilateral_means(color, filled, unknown, spatial, likeness)
        reached = ~np.isnan(means)
        if not reached.any():
            break
        filled[tuple(unknown[reached].T)] = means[reached]
        unknown = unknown[~reached]
    return filled


@parallel_jit
def _bilateral_means(color, values, pixels, spatial, likeness):
    height, width = values.shape
    reach = spatial.shape[0] // 2
    means = np.empty(len(pixels), np.float32)
    for n in prange(len(pixels)):
        y, x = pixels[n]
        r, g, b = np.int32(color[y, x, 0]), np.int32(color[y, x, 1]), np.int32(color[y, x, 2])
        total, weights = 0.0, 0.0
        for v in range(max(y - reach, 0), min(y + reach + 1, height)):
            for u in range(max(x - reach, 0), min(x + reach + 1, width)):
                value = values[v, u]
                if np.isnan(value):
                    continue
                dr, dg, db = color[v, u, 0] - r, color[v, u, 1] - g, color[v, u, 2] - b
                weight = spatial[v - y + reach, u - x + reach] * likeness[dr * dr + dg * dg + db * db]
                total += weight * value
                weights += weight
        # Where all colors differ, all weights underflow: left to the next round, when closer pixels are known.
        means[n] = total / weights if weights > 1e-30 else np.nan
    return means
