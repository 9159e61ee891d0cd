"""Small frames of depth sensors: with gaps, and with glass."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.frames import RgbdFrame, SparseFrame

NOISE = 0.004
"""Standard deviation of the samples of :func:`glass`, meters."""


def gaps(seed: int = 0, shape: tuple[int, int] = (60, 80)) -> tuple[RgbdFrame, NDArray[np.float32]]:
    """Return a frame of a box 1 m away before a wall at 2 m, with gaps of the sensor, and its (H, W) true depth."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: shape[0], : shape[1]]
    box = (abs(x - 0.5 * shape[1]) < 0.25 * shape[1]) & (abs(y - 0.5 * shape[0]) < 0.25 * shape[0])
    truth = np.where(box, 1, 2).astype(np.float32)
    color = np.where(box[..., None], (200, 150, 60), (60, 90, 140)) + rng.normal(0, 3, (*shape, 3))
    depth = np.where(rng.random(shape) < 0.15, np.nan, truth + 0.002 * rng.standard_normal(shape)).astype(np.float32)
    depth[:, shape[1] // 8 : shape[1] // 5] = np.nan
    return RgbdFrame(np.clip(color, 0, 255).astype(np.uint8), depth), truth


def glass(
    seed: int = 0, shape: tuple[int, int] = (72, 96), share: float = 0.1, outliers: float = 0.1, unknown: float = 0.4
) -> tuple[SparseFrame, NDArray[np.float32], NDArray[np.bool_]]:
    """Return a frame, its true depth and the mask of the glass, (H, W).

    A table at 1 m, slightly slanted; a disk at 0.8 m of another color that the sensor sees through or not at all.

    Parameters
    ----------
    seed, shape : of the random numbers; height and width, pixels
    share : of the pixels that have a sample
    outliers : share of the samples that are wrong
    unknown : share of the glass that the sensor does not see at all
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
