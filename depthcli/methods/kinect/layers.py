"""Layers of segments: a surface for each segment of a layer, and the disparity computed from all layers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from depthcli.algorithms.plane_fitting.polynomials import Surfaces, surface_at
from depthcli.algorithms.regions import region_adjacency, region_sums
from depthcli.core.cameras.triangulation import depth_of_disparity
from depthcli.core.frames import RgbdFrame
from depthcli.core.maps import DepthMap, DepthStatus, Floats, Image8, Ints, Mask
from depthcli.core.result import DepthResult
from depthcli.kernels.jit import empty, helper, jit, run_bands
from depthcli.methods.kinect.disparity import Measurement
from depthcli.methods.kinect.gap_filling import SHADOW_COST, UNRELIABLE_COST, fill_gaps

_BOUNDARY_COST = 10  # cost of a common boundary one pixel long, grey levels; value of the shipped presets, not varied
_COLUMNS = 64  # columns per task of the vertical pass: whole cache lines

_KEPT, _FILLED, _CORRECTED = int(DepthStatus.KEPT), int(DepthStatus.GAP_FILLED), int(DepthStatus.CORRECTED)
_FALLBACK, _EMPTY, _SMOOTHED = int(DepthStatus.FALLBACK), int(DepthStatus.EMPTY), int(DepthStatus.SMOOTHED)


@dataclass(frozen=True)
class Layer:
    """A partition of the frame with a surface for every part."""

    labels: Ints  # (H, W), index of each pixel's surface, -1 = none
    surfaces: Surfaces
    own: Mask  # (H, W), the surface was fitted to the pixel's own segment, not to one that it joined

    def estimate(self, reliable: Floats, reach: float) -> tuple[Floats, Floats]:
        """Return value and scale, (H, W) float32, with detail near reliable pixels (``reach`` pixels; 0: no detail)."""
        values = self.surfaces.at(self.labels)
        if reach:
            add_detail(values, reliable, self.labels, self.surfaces.scale, reach)
        return values, np.where(self.labels < 0, np.float32(np.nan), self.surfaces.scale[self.labels])


@dataclass(frozen=True)
class RefinedDisparity:
    """A refined disparity map and its standard deviation, (H, W), pixels, NaN = none."""

    disparity: Floats
    scale: Floats
    status: Image8  # bits of DepthStatus

    @classmethod
    def of(
        cls, layers: list[Layer], measurement: Measurement, reach: float, tolerance: float, smooth: bool
    ) -> RefinedDisparity:
        """Combine layers: use their median if a measurement is unknown, or if it is unreliable and far from the median.

        In gaps, paths from known pixels replace the median; their difference from it counts as uncertainty.

        Parameters
        ----------
        reach : reach of detail, see :meth:`Layer.estimate`
        tolerance : a measured value that is off by more scales contradicts the surface
        smooth : also replace measured values that agree with the surface
        """
        measured, reliable, noise = measurement.disparity, measurement.reliable, np.float32(measurement.noise)
        values, scales = (np.empty((len(layers), *measured.shape), np.float32) for _ in range(2))
        for k, layer in enumerate(layers):
            values[k], scales[k] = layer.estimate(reliable, reach)
        own = np.any([layer.own for layer in layers], axis=0)
        disparity, scale = np.empty_like(measured), np.empty_like(measured)
        status = np.empty(measured.shape, np.uint8)
        given = measured, reliable, np.float32(tolerance), noise, smooth
        run_bands(_decide, values.shape[1], values, scales, own, *given, disparity, scale, status)
        cost = np.where(np.isnan(reliable), np.float32(UNRELIABLE_COST), np.float32(0))
        segments, known = np.stack([layer.labels for layer in layers]), ~np.isnan(measured)
        start = np.where(known, disparity, np.float32(np.nan))
        filled, inside = fill_gaps(start, measurement.lab, segments, measurement.limit, cost, measurement.noise)
        uncertain = np.fmax(np.fmax(scale, np.abs(filled - disparity)), noise)
        filled_status = np.where(inside, np.uint8(_FILLED), np.uint8(_FALLBACK))
        return cls(filled, np.where(known, scale, uncertain), np.where(known, status, filled_status))

    def to_depth(self, frame: RgbdFrame) -> DepthResult:
        """Convert to depth; kept measurements retain the sensor's exact depth."""
        depth = depth_of_disparity(self.disparity, frame.fb)
        kept = self.status == DepthStatus.KEPT
        depth[kept] = frame.depth[kept]
        status = np.where(np.isnan(depth), np.uint8(DepthStatus.EMPTY), self.status)
        return DepthResult(depth=DepthMap(depth, status))


@helper
def _insert(sorted_values, count, value):
    i = count
    while i > 0 and sorted_values[i - 1] > value:
        sorted_values[i] = sorted_values[i - 1]
        i -= 1
    sorted_values[i] = value


@helper
def _median(sorted_values, count):
    middle = count >> 1
    if count & 1:
        return sorted_values[middle]
    return np.float32(0.5) * (sorted_values[middle - 1] + sorted_values[middle])


@jit
def _decide(begin, end, values, scales, own, disparity, reliable, tolerance, noise, smooth, out, scale, status):
    layers, _, width = values.shape
    for y in range(begin, end):
        value, spread = empty(layers, np.float32), empty(layers, np.float32)
        for x in range(width):
            count = 0
            for k in range(layers):
                if np.isnan(values[k, y, x]):
                    continue
                _insert(value, count, values[k, y, x])
                _insert(spread, count, scales[k, y, x])
                count += 1
            measured = disparity[y, x]
            if count == 0:
                out[y, x] = measured
                scale[y, x] = np.nan if np.isnan(measured) else noise
                status[y, x] = _EMPTY if np.isnan(measured) else _KEPT
                continue
            middle = _median(value, count)
            scale[y, x] = max(_median(spread, count), noise)
            if np.isnan(measured):
                out[y, x] = middle
                status[y, x] = _FILLED if own[y, x] else _FALLBACK
            elif abs(measured - middle) <= tolerance * scale[y, x]:
                out[y, x] = middle if smooth else measured
                status[y, x] = _KEPT | _SMOOTHED if smooth else _KEPT
            elif np.isnan(reliable[y, x]):
                out[y, x] = middle
                status[y, x] = _CORRECTED
            else:
                out[y, x] = measured
                status[y, x] = _KEPT


def join_segments(labels: Ints, modelled: Mask, surfaces: Surfaces, color: Image8, limit: Floats) -> Ints:
    """Assign a surface to every segment: its own surface, or the surface of the modelled segment that it joins.

    Each segment without a model joins along the cheapest path through neighbors. A step costs the sum of the absolute
    differences of the mean colors, plus 10 / sqrt(length of the common boundary), plus ``SHADOW_COST`` if the
    surface would be nearer than the segment's mean shadow ``limit``.

    Returns (n,) int32 indices of surfaces for the n segments; -1 if no model reaches a segment.
    """
    count = modelled.size
    owners = np.where(modelled, np.arange(count, dtype=np.int32), np.int32(-1))
    if modelled.all() or not modelled.any():
        return owners
    limited = limit < np.inf
    planes = np.dstack([color, *np.indices(labels.shape, np.float32), limited, np.where(limited, limit, 0)])
    sizes, sums = region_sums(labels, planes, count)
    means = sums[:, :5] / sizes[:, None]  # color, and the center's row and column
    n_limited, total = sums[:, 5:].T
    # The mean limit, if more than a third of the segment's pixels have one.
    limits = np.where(3 * n_limited > sizes, total / np.maximum(n_limited, 1), np.inf)
    starts, neighbors, boundary = region_adjacency(labels, count)
    _join(owners, means, limits, starts, neighbors, boundary, surfaces)
    return owners


@jit
def _join(owners, means, limits, starts, neighbors, boundary, surfaces):
    waiting = empty((owners.size + neighbors.size, 3), np.float64)  # a heap of (cost, segment, owner)
    size = 0
    for s in range(owners.size):
        if owners[s] == s:
            _push(waiting, size, 0.0, s, s)
            size += 1
    modelled = owners >= 0
    while size > 0:
        cost, s, owner = waiting[0, 0], int(waiting[0, 1]), int(waiting[0, 2])
        size -= 1
        _remove_first(waiting, size)
        if not modelled[s]:
            if owners[s] >= 0:
                continue
            owners[s] = owner
        for k in range(starts[s], starts[s + 1]):
            t = neighbors[k]
            if owners[t] >= 0:
                continue
            step = _BOUNDARY_COST / np.sqrt(float(boundary[k]))
            for c in range(3):
                step += abs(means[s, c] - means[t, c])
            if surface_at(surfaces, owner, means[t, 3], means[t, 4]) > limits[t]:
                step += SHADOW_COST
            _push(waiting, size, cost + step, t, owner)
            size += 1


@helper
def _precedes(heap, i, j):
    for c in range(2):
        if heap[i, c] != heap[j, c]:
            return heap[i, c] < heap[j, c]
    return heap[i, 2] < heap[j, 2]


@helper
def _exchange(heap, i, j):
    for c in range(3):
        heap[i, c], heap[j, c] = heap[j, c], heap[i, c]


@helper
def _push(heap, size, cost, segment, owner):
    # Add a row to the first ``size`` rows of a binary heap (heapq takes ten times as long to compile).
    heap[size, 0], heap[size, 1], heap[size, 2] = cost, segment, owner
    k = size
    while k > 0 and _precedes(heap, k, (k - 1) >> 1):
        _exchange(heap, k, (k - 1) >> 1)
        k = (k - 1) >> 1


@helper
def _remove_first(heap, size):
    # Leave the other ``size`` rows.
    _exchange(heap, 0, size)
    k, child = 0, 1
    while child < size:
        child += child + 1 < size and _precedes(heap, child + 1, child)
        if not _precedes(heap, child, k):
            break
        _exchange(heap, child, k)
        k, child = child, 2 * child + 1


def add_detail(surface: Floats, known: Floats, labels: Ints, scale: Floats, reach: float) -> None:
    """Add to ``surface``, in place, the smoothed residuals of nearby ``known`` values in the same segment.

    The weight falls by a factor e per ``reach`` pixels along a path within the segment, first along the row, then along
    the column. A prior of zero with the weight of half a pixel keeps the surface unchanged far from all known pixels.
    Residuals are limited to three times the segment's ``scale``.
    """
    weights, residuals = (np.empty(surface.shape, np.float32) for _ in range(2))
    decay = np.float32(np.exp(-1 / reach))
    run_bands(_residuals, len(surface), surface, known, labels, scale, decay, residuals, weights)
    run_bands(_spread_down, (labels.shape[1] + _COLUMNS - 1) // _COLUMNS, labels, decay, residuals, weights)
    surface += residuals / (weights + np.float32(0.5))


@jit
def _residuals(begin, end, surface, known, labels, scale, decay, residuals, weights):
    width = surface.shape[1]
    back = np.float32(1) - decay * decay  # the second pass adds to the sums of the first
    for y in range(begin, end):
        for x in range(width):
            s = labels[y, x]
            residual = known[y, x] - surface[y, x]
            residuals[y, x] = np.float32(0)
            weights[y, x] = np.float32(0)
            if not np.isnan(residual):
                limit = np.float32(3) * scale[s]
                residuals[y, x] = min(max(residual, -limit), limit)
                weights[y, x] = np.float32(1)
            if x > 0 and labels[y, x - 1] == s:
                residuals[y, x] += decay * residuals[y, x - 1]
                weights[y, x] += decay * weights[y, x - 1]
        for x in range(width - 2, -1, -1):
            if labels[y, x + 1] == labels[y, x]:
                residuals[y, x] = back * residuals[y, x] + decay * residuals[y, x + 1]
                weights[y, x] = back * weights[y, x] + decay * weights[y, x + 1]


@jit
def _spread_down(begin, end, labels, decay, residuals, weights):
    height, width = labels.shape
    back = np.float32(1) - decay * decay
    for task in range(begin, end):
        first = task * _COLUMNS
        stop = min(first + _COLUMNS, width)
        for y in range(1, height):
            for x in range(first, stop):
                if labels[y, x] == labels[y - 1, x]:
                    residuals[y, x] += decay * residuals[y - 1, x]
                    weights[y, x] += decay * weights[y - 1, x]
        for y in range(height - 2, -1, -1):
            for x in range(first, stop):
                if labels[y, x] == labels[y + 1, x]:
                    residuals[y, x] = back * residuals[y, x] + decay * residuals[y + 1, x]
                    weights[y, x] = back * weights[y, x] + decay * weights[y + 1, x]
