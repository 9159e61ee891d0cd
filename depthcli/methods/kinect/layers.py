"""Layers of segments: the surface of each segment of a layer, and the disparity that follows from all layers."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.plane_fitting.polynomials import Surfaces
from depthcli.core.cameras.triangulation import depth_of_disparity
from depthcli.core.frames import RgbdFrame
from depthcli.core.maps import DepthMap, DepthStatus
from depthcli.core.result import DepthResult
from depthcli.kernels.jit import jit, parallel_jit, prange
from depthcli.methods.kinect.depth_edges import correct_probability
from depthcli.methods.kinect.disparity import deviation_of_depth, measured_disparity, noise_level
from depthcli.methods.kinect.gap_filling import UNRELIABLE_COST, fill_gaps
from depthcli.methods.kinect.model import SurfaceModel
from depthcli.methods.kinect.segment_surfaces import add_detail, join_segments
from depthcli.methods.kinect.shadows import Shadows, Side, max_disparity_in_gaps, shadows_of

_CORE_PROBABILITY = 0.6  # of an unreliable pixel that is more probably correct than its neighbors: of thin objects
_MIN_CORE_PIXELS = 5  # of a segment, for a surface to be fitted to them; value of the shipped presets, not varied

_KEPT, _FILLED, _CORRECTED = int(DepthStatus.KEPT), int(DepthStatus.GAP_FILLED), int(DepthStatus.CORRECTED)
_FALLBACK, _EMPTY, _SMOOTHED = int(DepthStatus.FALLBACK), int(DepthStatus.EMPTY), int(DepthStatus.SMOOTHED)


@dataclass(frozen=True)
class Measurement:
    """The measured disparity of a frame, and where it is reliable; maps are (H, W), in pixels."""

    disparity: NDArray[np.float32]
    probability: NDArray[np.float32]  # that a measured value belongs to the surface of its pixel; 1 without colors
    reliable: NDArray[np.float32]  # the disparity without unreliable pixels
    core: NDArray[np.bool_]  # the more probable ones of the unreliable pixels; thin objects have no others
    limit: NDArray[np.float32]  # largest disparity that fits the gap, inf where the gap is no shadow
    noise: float  # standard deviation
    shadows: Shadows = field(default_factory=Shadows)

    @classmethod
    def of(
        cls,
        frame: RgbdFrame,
        lab: NDArray[np.uint8],
        jump: float,
        min_probability: float,
        where: bool | Side,
        noise: float | None = None,
    ) -> Measurement:
        """Classify the pixels of a frame; ValueError where none has a depth.

        Parameters
        ----------
        jump : larger steps are depth edges, multiples of the noise
        min_probability : measurements that are correct with less probability are unreliable; 0: none
        where : shadows lie, see :func:`shadows_of`
        """
        disparity = measured_disparity(frame)
        noise = noise_level(disparity) if noise is None else noise
        step = jump * noise
        shadows = shadows_of(disparity, step, where)
        probability = np.ones_like(disparity)
        if min_probability and frame.has_color:  # without colors nothing shows true outlines
            probability = correct_probability(lab, disparity, step, shadows)
        unreliable = ~np.isnan(disparity) & (probability < min_probability)
        core = unreliable & (probability > _CORE_PROBABILITY)
        reliable = np.where(unreliable, np.float32(np.nan), disparity)
        limit = max_disparity_in_gaps(disparity, step, shadows.likely())
        return cls(disparity, probability, reliable, core, limit, noise, shadows)


@dataclass(frozen=True)
class Layer:
    """A partition of the frame with a surface for every part."""

    labels: NDArray[np.int32]  # (H, W), the surface of every pixel, -1 where there is none
    surfaces: Surfaces
    own: NDArray[np.bool_]  # (H, W), the surface was fitted to the pixel's own segment, not to one that it joined

    def estimate(self, measurement: Measurement, reach: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Evaluate value and scale, (H, W) float32, with detail within ``reach`` pixels of reliable ones; 0: none."""
        values = self.surfaces.at(self.labels)
        if reach:
            add_detail(values, measurement.reliable, self.labels, self.surfaces.scale, reach)
        scale = np.where(self.labels < 0, np.float32(np.nan), self.surfaces.scale[self.labels])
        return values, scale


def fit_layer(
    measurement: Measurement,
    labels: NDArray[np.int32],
    color: NDArray[np.uint8],
    model: SurfaceModel,
    min_known: int,
    min_share: float,
    join: bool,
) -> Layer:
    """Fit ``model`` to the segments ``labels`` (H, W), and let segments where it cannot be fitted join others.

    Parameters
    ----------
    min_known, min_share : reliable pixels that a segment needs, and their share of it. With fewer, a segment whose
        measured pixels mostly are ``core`` pixels is fitted to those
    join : False: a segment without a model stays without a surface
    """
    count = int(labels.max()) + 1
    size, reliable, measured, core = (
        np.bincount(labels[chosen].ravel(), minlength=count)
        for chosen in (..., ~np.isnan(measurement.reliable), ~np.isnan(measurement.disparity), measurement.core)
    )
    modelled = (reliable >= min_known) & (reliable >= min_share * size)
    by_core = ~modelled & (core >= _MIN_CORE_PIXELS) & (2 * core >= measured)
    values = measurement.reliable
    if by_core.any():
        values = np.where(by_core[labels] & measurement.core, measurement.disparity, values)
    surfaces = model(values, labels, measurement.noise)
    modelled |= by_core
    owners = np.where(modelled, np.arange(count, dtype=np.int32), np.int32(-1))
    if join:
        owners = join_segments(labels, modelled, surfaces, color, measurement.limit)
    return Layer(owners[labels], surfaces, modelled[labels])


@dataclass(frozen=True)
class RefinedDisparity:
    """A refined disparity map and its standard deviation, (H, W), pixels, NaN = none."""

    disparity: NDArray[np.float32]
    scale: NDArray[np.float32]
    status: NDArray[np.uint8]  # bits of DepthStatus

    def joined(self, lab: NDArray[np.uint8], layers: list[Layer], measurement: Measurement) -> RefinedDisparity:
        """Fill gaps along paths from known pixels; what differs from the layers' own value there is that uncertain."""
        known = ~np.isnan(measurement.disparity)
        values = np.where(known, self.disparity, np.float32(np.nan))
        cost = np.where(np.isnan(measurement.reliable), np.float32(UNRELIABLE_COST), np.float32(0))
        segments = np.stack([layer.labels for layer in layers])
        filled, inside = fill_gaps(values, lab, segments, measurement.limit, cost, measurement.noise)
        off = np.abs(filled - self.disparity)
        scale = np.fmax(np.fmax(self.scale, off), np.float32(measurement.noise))
        status = np.where(inside, np.uint8(_FILLED), np.uint8(_FALLBACK))
        return RefinedDisparity(filled, np.where(known, self.scale, scale), np.where(known, self.status, status))

    def to_depth(self, frame: RgbdFrame) -> DepthResult:
        """Convert to depth; kept measurements have the sensor's exact value."""
        depth = depth_of_disparity(self.disparity, frame.fb)
        kept = self.status == DepthStatus.KEPT
        depth[kept] = frame.depth[kept]
        status = np.where(np.isnan(depth), np.uint8(DepthStatus.EMPTY), self.status)
        return DepthResult(depth=DepthMap(depth, status), sigma=deviation_of_depth(self.scale, depth, frame.fb))


def combine(
    layers: list[Layer], measurement: Measurement, reach: float, tolerance: float, smooth: bool
) -> RefinedDisparity:
    """Compute the disparity: the median of the layers where a measurement is unknown or unreliable and far from it.

    Parameters
    ----------
    reach : of detail, see :meth:`Layer.estimate`
    tolerance : a measured value that is off by more scales contradicts the surface
    smooth : replace measured values that agree with the surface, too
    """
    shape = (len(layers), *measurement.disparity.shape)
    values, scales, own = np.empty(shape, np.float32), np.empty(shape, np.float32), np.zeros(shape[1:], bool)
    for k, layer in enumerate(layers):
        values[k], scales[k] = layer.estimate(measurement, reach)
        own |= layer.own
    disparity, scale = np.empty(shape[1:], np.float32), np.empty(shape[1:], np.float32)
    result = RefinedDisparity(disparity, scale, np.empty(shape[1:], np.uint8))
    given = (measurement.disparity, measurement.reliable, np.float32(tolerance), np.float32(measurement.noise), smooth)
    _decide(values, scales, own, *given, result.disparity, result.scale, result.status)
    return result


@jit
def _insert(sorted_values, count, value):
    i = count
    while i > 0 and sorted_values[i - 1] > value:
        sorted_values[i] = sorted_values[i - 1]
        i -= 1
    sorted_values[i] = value


@jit
def _median(sorted_values, count):
    middle = count >> 1
    if count & 1:
        return sorted_values[middle]
    return np.float32(0.5) * (sorted_values[middle - 1] + sorted_values[middle])


@parallel_jit
def _decide(values, scales, own, disparity, reliable, tolerance, noise, smooth, out, scale, status):
    layers, height, width = values.shape
    for y in prange(height):
        value, spread = np.empty(layers, np.float32), np.empty(layers, np.float32)
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
