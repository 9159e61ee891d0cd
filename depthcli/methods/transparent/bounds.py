"""Error bounds for every value of a completed depth map, from the frame and the map, for any completion method.

Each plane of ``evidence`` adds to a score by a curve. A table (``algorithms.error_table``) has the distribution of
errors at each score. There are curves and a table for each kind of pixel: kept values of the sensor; values that
replace the sensor or fill its gaps; and values inside a mask of objects, continued from the surroundings.
``scripts/train_glass_bounds.py`` fits them and checks them on held-out data sets.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.error_table import ErrorTable
from depthcli.algorithms.filters import local_range
from depthcli.core.frames import SparseFrame
from depthcli.core.maps import DepthMap, Doubles, Floats, Mask

EVIDENCE = ("residual", "gap", "gap_width", "distance", "edge", "noise", "border", "relief")
"""Names of the planes of :func:`evidence`, all binary logarithms.

In order: residuals of the samples around, relative to the depth; radius of the largest disc that covers the pixel and
no sample, over the mean spacing of samples; the same radius over the width of the image; distance from the nearest
sample, over the width; range of log depth in 7 x 7; noise of the sensor, relative to the depth; distance from the
border between kept and other pixels, over the width; range of log depth in a window of an eighth of the width.
"""
KINDS = ("kept", "replaced", "unmeasured")
"""Kinds of pixels."""
_SMALLEST = 2.0**-13  # floor of the arguments of logarithms
_UNIT = np.float32(2.0**-10)  # unit of errors of values that were not kept, share of the depth
_LEAST_NOISE = np.float32(-9.0)  # floor of the sensor's noise: neighbors share a part of it; binary logarithm
_REACH = 1.5  # Gaussian of the mean of residuals, spacings of samples
_MAX_REACH = 1 / 16  # its largest value, share of the width
_NOISE_REACH = 0.02  # Gaussian of the mean of the sensor's noise, share of the width


class GlassErrors(NamedTuple):
    """Curves and tables that convert evidence to error bounds.

    Attributes
    ----------
    curves : (n, 2 + kinds) float64, points of the curves: index of the plane, its value, and for each kind the term
        added to the score
    tables : for each kind, the errors at each score, in multiples of the unit that ``units`` returns
    """

    curves: Doubles
    tables: tuple[ErrorTable, ...]


def glass_bounds(
    given: GlassErrors, frame: SparseFrame, found: DepthMap, level: float, within: float
) -> tuple[Floats, Floats]:
    """Return error bound and probability of a frame's map, (H, W) float32.

    The bound, in meters, has the coverage ``level``. The probability is for an error up to ``within`` meters. At pixels
    without a value the bound is NaN and the probability 0.
    """
    planes = evidence(frame, found)
    kinds, unit = kinds_of(frame, found), units(planes, found)
    bound, probability = np.full_like(unit, np.nan), np.zeros_like(unit)
    for kind, table in enumerate(given.tables):
        if (here := found.valid & (kinds == kind)).any():
            odds = score(given.curves, kind, planes)
            bound[here] = (unit * table.bound(odds, level))[here]
            probability[here] = table.probability(odds, np.float32(within) / unit)[here]
    return bound, probability


def kinds_of(frame: SparseFrame, found: DepthMap) -> NDArray[np.int_]:
    """Return the index of each pixel's kind in ``KINDS``, (H, W)."""
    objects = False if frame.objects is None else frame.objects
    return np.where(found.kept, 0, np.where(objects, 2, 1))


def units(planes: Floats, found: DepthMap) -> Floats:
    """Return the unit of the errors in the tables, (H, W), meters: the sensor's noise, or a share of the depth."""
    noise = np.exp2(np.maximum(planes[EVIDENCE.index("noise")], _LEAST_NOISE), dtype=np.float64)
    return np.asarray(found.values * np.where(found.kept, noise, _UNIT), np.float32)


def score(curves: Doubles, kind: int, planes: Floats) -> Floats:
    """Return the negative sum of the curves' values at ``planes`` (F, ...); higher is more reliable."""
    total = np.zeros(planes.shape[1:], np.float32)
    for number, plane in enumerate(planes):
        points = curves[curves[:, 0] == number]
        total -= np.interp(plane, points[:, 1], points[:, 2 + kind]).astype(np.float32)
    return total


def evidence(frame: SparseFrame, found: DepthMap) -> Floats:
    """Return the planes ``EVIDENCE``, (F, H, W) float32, of the map ``found`` for a frame.

    If the frame has a mask of the objects, kept depths count as samples.
    """
    width = frame.shape[1]
    kept, depth = found.kept, np.where(found.valid, found.values, np.float32(1))
    sampled = np.isfinite(frame.sparse) if frame.objects is None else kept
    values = frame.sparse if frame.objects is None else found.values
    spacing = float(np.sqrt(sampled.size / max(int(np.count_nonzero(sampled)), 1)))
    residual = np.zeros(frame.shape, np.float32)
    residual[sampled] = _log2(np.abs(values[sampled] / depth[sampled] - 1))
    common = float(np.median(residual[sampled])) if sampled.any() else -3.0
    distance, log_depth = _distance(sampled), _log2(depth)
    gap = _empty_discs(distance)
    planes = (
        _local_mean(residual, sampled, min(_REACH * spacing, _MAX_REACH * width), common),
        _log2((gap + 1) / (spacing + 1)),
        _log2((gap + 1) / width),
        _log2((distance + 1) / width),
        _log2(local_range(log_depth, 7)),
        _noise(np.where(kept, frame.depth, np.float32(np.nan)), _NOISE_REACH * width),
        _log2((np.where(kept, _distance(~kept), _distance(kept)) + 1) / width),
        _log2(local_range(log_depth, width // 16 * 2 + 1)),
    )
    return np.stack(planes)


def _log2(values: NDArray[np.floating[Any]]) -> Floats:
    # In float64: the last bit of a float32 logarithm depends on the array's alignment.
    exact = np.log2(np.maximum(np.nan_to_num(values, posinf=1), _SMALLEST), dtype=np.float64)
    return np.asarray(exact, np.float32)


def _distance(where: Mask) -> Floats:
    """Return the distance of every pixel from the nearest pixel of ``where``; the image's diagonal if there is none."""
    if not where.any():
        return np.full(where.shape, np.hypot(*where.shape), np.float32)
    found = cv2.distanceTransform((~where).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.asarray(np.sqrt(np.rint(found * found)), np.float32)  # OpenCV's last bit varies


def _empty_discs(distance: Floats) -> Floats:
    """Return the radius of the largest disc that covers a pixel and no sample, in steps of a factor of 1.4."""
    found, radius = distance.copy(), np.float32(1)
    while radius <= distance.max():
        covered = _distance(distance >= radius) <= radius
        found[covered] = np.maximum(found[covered], radius)
        radius *= np.float32(np.sqrt(2))
    return found


def _local_mean(values: Floats, where: Mask, reach: float, common: float) -> Floats:
    """Return the Gaussian-weighted mean of the values at pixels ``where``, or ``common`` if hardly one is near."""
    weight, few = _blurred(where.astype(np.float32), reach), np.float32(0.05 / reach**2)
    mean: Floats = (_blurred(np.where(where, values, np.float32(0)), reach) + few * np.float32(common)) / (weight + few)
    return mean


def _blurred(plane: Floats, sigma: float) -> Floats:
    return np.asarray(cv2.GaussianBlur(plane, (0, 0), sigma, borderType=cv2.BORDER_REFLECT), np.float32)


def _noise(depth: Floats, reach: float) -> Floats:
    """Return the binary logarithm of the noise relative to the depth, from second differences of the inverse depth."""
    inverse = (1 / depth).astype(np.float32)
    total, count = np.zeros_like(depth), np.zeros_like(depth)
    for axis in (0, 1):
        middle = np.moveaxis(inverse, axis, 0)
        second = np.abs(middle[:-2] - 2 * middle[1:-1] + middle[2:]) / (np.sqrt(np.float32(6)) * middle[1:-1])
        np.moveaxis(total, axis, 0)[1:-1] += np.where(np.isnan(second), 0, _log2(second))
        np.moveaxis(count, axis, 0)[1:-1] += ~np.isnan(second)
    known = count > 0
    mean = np.where(known, total / np.maximum(count, 1), np.float32(0)).astype(np.float32)
    return _local_mean(mean, known, reach, float(np.median(mean[known])) if known.any() else -8.0)
