"""Error bounds for every value of a refined depth map, from the frame and the map, for any refinement method.

A small network computes the log odds of an error up to twice the frame's noise from planes that describe a pixel's
surroundings (``error_planes``). A table (``algorithms.error_table``) has the distribution of errors at these odds, in
multiples of the noise. ``scripts/train_depth_bounds.py`` trains both on simulated sensors and on blocks cut out of real
frames.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import cv2
import numpy as np

from depthcli.algorithms.error_table import ErrorTable
from depthcli.algorithms.filters import local_range
from depthcli.algorithms.pixel_network import TrainedNetwork, log_odds
from depthcli.core.frames import RgbdFrame
from depthcli.core.maps import DepthMap, DepthStatus, Floats, Mask
from depthcli.methods.kinect.disparity import nearest_fill, noise_level

THRESHOLDS = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
"""Thresholds in multiples of the noise; the first layer of the network has a row of offsets for each."""
INPUTS = (
    "corrected", "filled", "fallback", "distance_to_kept", "kept_around", "known_around", "step_here", "step_around",
    "distance_to_step", "range_3", "range_15", "distance_to_edge", "from_nearest", "roughness", "roughness_of_map",
    "roughness_of_sensor", "change", "change_of_map", "corrected_of_map", "contrast_at_edges", "contrast_at_new_edges",
)  # fmt: skip
"""Names of the planes, in order."""
BYTES_PER_PIXEL = 220
"""Estimate of the peak working memory of bounds."""
_SCORE = THRESHOLDS.index(2.0)  # index of the threshold whose log odds the table uses
_EDGE = 5.0  # a larger step between neighbors is a depth edge, multiples of the noise, as in all pipelines
_LOG2_E = np.float32(math.log2(math.e))
_FAR = 64.0  # pixels; larger distances count as this
_EVERY = 3  # medians of a map use every third row and column
_CELL = 4  # side of the cells for the largest step around, pixels


class DepthErrors(NamedTuple):
    """A network for log odds, and the table of errors at these odds, in multiples of the noise."""

    network: TrainedNetwork
    errors: ErrorTable


def depth_bounds(
    given: DepthErrors, frame: RgbdFrame, found: DepthMap, level: float, within: float
) -> tuple[Floats, Floats]:
    """Return error bound and probability of a frame's refined map, (H, W) float32.

    The bound, in meters, applies to the side behind the value, which is the wider one. It is infinite if nothing limits
    the depth, and NaN at pixels without a value. The probability is 0 there.

    Parameters
    ----------
    level : coverage of the bound: the share of the errors that do not exceed it
    within : the probability is for an error up to this, meters
    """
    planes, noise = error_planes(frame, found)
    odds = log_odds(given.network, given.network.layers[0][1][_SCORE], planes, planes[:0])
    depth, fb = found.values, np.float32(frame.fb)
    disparity = fb / depth
    off = noise * given.errors.bound(odds, level)
    with np.errstate(divide="ignore", over="ignore"):
        bound = np.where(off < disparity, depth * off / (disparity - off), np.float32(np.inf))
    limit = np.asarray(disparity * np.float32(within) / (depth + np.float32(within)) / noise, np.float32)
    probability = given.errors.probability(odds, limit)
    return np.where(found.valid, bound, depth), np.where(found.valid, probability, np.float32(0))


def error_planes(frame: RgbdFrame, found: DepthMap) -> tuple[Floats, np.float32]:
    """Return the planes ``INPUTS``, (F, H, W) float32, and the noise of the frame, pixels.

    Disparities are in multiples of the noise; distances, steps and contrasts are binary logarithms.
    """
    measured = frame.disparity
    known, noise = ~np.isnan(measured), np.float32(noise_level(measured))
    corrected = known & ((found.status & DepthStatus.CORRECTED) != 0)
    kept = known & ~corrected
    values = nearest_fill((np.float32(frame.fb) / found.values).astype(np.float32)) / noise
    sensor = nearest_fill(np.where(kept, measured, np.float32(np.nan))) / noise if kept.any() else values
    step, range_3 = local_range(sensor, 3), local_range(values, 3)
    edge = range_3 > _EDGE
    rough = _roughness(values)
    change = np.where(known, np.abs(values - np.nan_to_num(measured) / noise), np.float32(0))
    around, small = _mean(known, 7), np.float32(0.01)
    grey = cv2.cvtColor(frame.color, cv2.COLOR_RGB2GRAY)
    across, down = cv2.Sobel(grey, cv2.CV_32F, 1, 0), cv2.Sobel(grey, cv2.CV_32F, 0, 1)
    # cv2.magnitude depends on the number of threads.
    contrast = cv2.dilate(np.sqrt(across * across + down * down) / 8, np.ones((3, 3), np.uint8))
    edges = _mean(edge, 9)

    def of_map(plane: Floats) -> float:
        some = plane[::_EVERY, ::_EVERY][kept[::_EVERY, ::_EVERY]]
        return float(np.median(some)) if some.size else 1.0

    def over_mean(pixels: Mask) -> float:
        mean = float(contrast.mean())
        return max(float(contrast[pixels].mean()) if pixels.any() else mean, 0.5) / max(mean, 0.5)

    planes = (
        corrected,
        ~known,
        (found.status & DepthStatus.FALLBACK) != 0,
        _log2(_distance(~kept), 0.5),
        _mean(kept, 9),
        _mean(known, 9),
        _log2(step, 0.5),
        _log2(_largest_around(step), 0.5),
        _log2(_distance(step <= _EDGE), 0.5),
        _log2(range_3, 1 / 16),
        _log2(local_range(values, 15), 1 / 4),
        _log2(_distance(~edge), 0.5),
        _log2(np.abs(values - sensor), 0.25),
        _log2(_mean(rough, 7), 1 / 64),
        _log2(of_map(rough), 1 / 64),
        _log2(of_map(_roughness(sensor)), 1 / 64),
        _log2(np.where(around > small, _mean(np.minimum(change, 8), 7) / np.maximum(around, small), 0), 1 / 64),
        _log2(of_map(change), 1 / 64),
        corrected.sum() / max(known.sum(), 1),
        _log2(np.where(edges > 1e-3, _mean(edge * contrast, 9) / np.maximum(edges, 1e-3), 32), 0.5),
        _log2(over_mean(edge & ~kept), 1e-3),
    )
    stacked = np.empty((len(planes), *frame.shape), np.float32)
    for target, plane in zip(stacked, planes, strict=True):
        target[:] = plane
    return stacked, noise


def _log2(values: Any, smallest: float) -> Any:
    if isinstance(values, float):
        return np.float32(np.log2(max(values, smallest)))
    return cv2.log(np.maximum(values, np.float32(smallest))) * _LOG2_E


def _distance(pixels: Mask) -> Floats:
    """Return the distance of each of ``pixels`` from the nearest other pixel, at most ``_FAR``, 0 at the others."""
    found = cv2.distanceTransform(pixels.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5)
    return np.asarray(np.minimum(found, np.float32(_FAR)), np.float32)


def _roughness(values: Floats) -> Floats:
    """Return the absolute second difference along the row or the column, whichever is smaller."""
    padded = np.pad(values, 1, mode="edge")
    across, down = padded[1:-1, 2:] + padded[1:-1, :-2], padded[2:, 1:-1] + padded[:-2, 1:-1]
    return np.asarray(np.minimum(np.abs(across - 2 * values), np.abs(down - 2 * values)), np.float32)


def _mean(values: Floats | Mask, side: int) -> Floats:
    return np.asarray(cv2.blur(values.astype(np.float32), (side, side), borderType=cv2.BORDER_REPLICATE), np.float32)


def _largest_around(values: Floats) -> Floats:
    """Return the largest value within about 10 pixels, constant within cells of 4 x 4."""
    height, width = values.shape
    padded = np.pad(values, ((0, -height % _CELL), (0, -width % _CELL)), mode="edge")
    cells = padded.reshape(padded.shape[0] // _CELL, _CELL, padded.shape[1] // _CELL, _CELL).max(axis=(1, 3))
    largest = cv2.dilate(cells, np.ones((5, 5), np.uint8))
    return np.asarray(largest.repeat(_CELL, axis=0).repeat(_CELL, axis=1)[:height, :width], np.float32)
