"""Sparse depth as a stereo matcher might have given it, emulated from a true depth map."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray


def sparse_samples(
    depth: NDArray[np.float32],
    color: NDArray[np.uint8],
    share: float,
    noise: float = 0.008,
    outliers: float = 0.1,
    clustered: bool = False,
    seed: int = 0,
) -> NDArray[np.float32]:
    """Some pixels of ``depth``, with Gaussian noise and wrong values.

    Parameters
    ----------
    depth : (H, W) float32, meters, NaN = unknown (never chosen)
    color : (H, W, 3) uint8
    share : of all pixels that get a sample, in [0, 1]
    noise : standard deviation, meters
    outliers : share of the samples that are uniform between the 1st and the 99th percentile of ``depth`` instead
    clustered : samples lie along edges of color, where stereo finds texture: a pixel's chance grows with the 1.5th
        power of the image's gradient; else all pixels are as likely
    seed : of everything random

    Returns
    -------
    (H, W) float32, meters, NaN = no sample
    """
    if not (0 <= share <= 1 and 0 <= outliers <= 1 and noise >= 0):
        raise ValueError(f"want shares in [0, 1] and noise >= 0, got {share}, {outliers}, {noise}")
    rng = np.random.default_rng([seed, 0x5A])
    known = np.flatnonzero(np.isfinite(depth))
    count = min(round(share * depth.size), known.size)
    chance = None
    if clustered:
        grey = cv2.cvtColor(color, cv2.COLOR_RGB2GRAY).astype(np.float32)
        gradient = np.hypot(cv2.Sobel(grey, cv2.CV_32F, 1, 0), cv2.Sobel(grey, cv2.CV_32F, 0, 1)).ravel()[known]
        chance = (gradient.astype(np.float64) + 1e-3) ** 1.5
        chance /= chance.sum()
    chosen = rng.choice(known, count, replace=False, p=chance)
    values = depth.ravel()[chosen] + noise * rng.standard_normal(count)
    wrong = rng.random(count) < outliers
    if wrong.any():
        low, high = np.nanquantile(depth, [0.01, 0.99])
        values[wrong] = rng.uniform(low, high, int(wrong.sum()))
    sparse = np.full(depth.size, np.nan, np.float32)
    sparse[chosen] = np.where(values > 0, values, np.nan)
    return sparse.reshape(depth.shape)
