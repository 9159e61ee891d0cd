"""Planes of a map's shape and of the left image: what can be said of a pixel without the right image."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.filters import local_moments

SHAPE = (
    *(f"deviation_of_map_{side}" for side in (5, 11, 21, 41)),
    *("above_mean_11", "above_mean_25", "above_median_5", "above_median_21", "edge_distance"),
    *("step_right", "step_left", "step_around", "relative"),
)
"""Planes of a map's shape: standard deviations of windows, differences from means and medians of windows, distance to
the next step, steps to the largest disparity beside a pixel and to the smallest around, share of the range."""
IMAGE = ("deviation_5", "deviation_13", "deviation_31", "gradient", "border_distance")
ONE_VIEW = (*SHAPE, *IMAGE)
"""Planes of a map and the left image alone."""

_MAX_DEVIATION = np.float32(40.0)  # grey levels


def shape_planes(values: NDArray[np.float32], max_disparity: int) -> dict[str, NDArray[Any]]:
    """Return the planes ``SHAPE`` of a map without gaps, (H, W) float32 each."""
    height, width = values.shape
    plane: dict[str, NDArray[Any]] = {}
    for side in (5, 11, 21, 41):
        plane[f"deviation_of_map_{side}"] = np.minimum(np.sqrt(local_moments(values, side)[1]), 10)
    for side in (11, 25):
        plane[f"above_mean_{side}"] = np.clip(values - cv2.blur(values, (side, side)), -6, 6)
    plane["above_median_5"] = np.clip(values - cv2.medianBlur(values, 5), -6, 6)
    top = np.float32(max(max_disparity, 1))
    coarse = cv2.medianBlur((values * (255 / top)).astype(np.uint8), 21).astype(np.float32) * (top / 255)
    plane["above_median_21"] = np.clip(values - coarse, -8, 8)
    edges = np.zeros((height, width), np.uint8)
    edges[:, 1:] |= np.abs(np.diff(values, axis=1)) > 1
    edges[1:] |= np.abs(np.diff(values, axis=0)) > 1
    far = np.full((height, width), 30, np.float32)
    plane["edge_distance"] = np.minimum(cv2.distanceTransform(1 - edges, cv2.DIST_L2, 3), 30) if edges.any() else far
    line = np.ones((1, 15), np.uint8)
    plane["step_right"] = np.minimum(cv2.dilate(values, line, anchor=(0, 0)) - values, 12)
    plane["step_left"] = np.minimum(cv2.dilate(values, line, anchor=(14, 0)) - values, 12)
    plane["step_around"] = np.minimum(values - cv2.erode(values, np.ones((9, 9), np.uint8)), 12)
    plane["relative"] = values / top
    return plane


def image_planes(grey: NDArray[np.float32]) -> dict[str, NDArray[Any]]:
    """Return the planes ``IMAGE`` of the left image, grey levels 0 .. 255, (H, W) float32 each."""
    height, width = grey.shape
    plane: dict[str, NDArray[Any]] = {
        f"deviation_{side}": np.minimum(np.sqrt(local_moments(grey, side)[1]), _MAX_DEVIATION) for side in (5, 13, 31)
    }
    plane["gradient"] = np.minimum(np.abs(cv2.Sobel(grey, cv2.CV_32F, 1, 0)) / 8, 30)
    columns, rows = np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)[:, None]
    beside, above = np.minimum(columns, width - 1 - columns), np.minimum(rows, height - 1 - rows)
    plane["border_distance"] = np.minimum(np.minimum(beside, above), 20)
    return plane


def one_view_planes(values: NDArray[np.float32], grey: NDArray[np.float32], max_disparity: int) -> NDArray[np.float32]:
    """Return the planes ``ONE_VIEW`` of a map without gaps, (len(ONE_VIEW), H, W) float32."""
    planes = shape_planes(values, max_disparity) | image_planes(grey)
    return np.stack([planes[name] for name in ONE_VIEW]).astype(np.float32)
