"""A small frame with glass in it."""

from __future__ import annotations

import cv2
import numpy as np

from depthcli.core.frames import SparseFrame

NOISE = 0.004


def glass(seed=0, shape=(72, 96), share=0.1, outliers=0.1, unknown=0.4):
    """A table at 1 m, slightly slanted; a disk at 0.8 m of another color that the sensor sees through or not at all.

    Frame, true depth and mask.
    """
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: shape[0], : shape[1]]
    mask = (x - 0.5 * shape[1]) ** 2 + (y - 0.5 * shape[0]) ** 2 < (0.28 * shape[0]) ** 2
    table = 1 / (1.0 + 0.0005 * (x - 0.5 * shape[1]))
    truth = np.where(mask, 0.8, table).astype(np.float32)
    color = np.where(mask[..., None], (90, 160, 170), (70, 110, 60)) + rng.normal(0, 3, (*shape, 3))
    sensor = table + 0.001 * rng.standard_normal(shape)
    spots = cv2.GaussianBlur(rng.standard_normal(shape), (0, 0), 3)
    sensor[mask & (spots < np.quantile(spots[mask], unknown))] = np.nan
    sparse = np.where(rng.random(shape) < share, truth + NOISE * rng.standard_normal(shape), np.nan)
    wrong = np.isfinite(sparse) & (rng.random(shape) < outliers)
    sparse[wrong] = rng.uniform(0.6, 1.4, wrong.sum())
    frame = SparseFrame(
        np.clip(color, 0, 255).astype(np.uint8), sensor.astype(np.float32), sparse=sparse.astype(np.float32)
    )
    return frame, truth, mask
