"""Refine the frames of a recording: carry segments from frame to frame with the camera's motion (thesis, chapter 4)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import cv2
import numpy as np
from pydantic import Field

from depthcli.algorithms.plane_fitting.polynomials import surface_at
from depthcli.core.cameras.camera import typical_intrinsics
from depthcli.core.context import Clock
from depthcli.core.frames import RgbdFrame
from depthcli.core.maps import DepthStatus, Doubles, Floats, Image8, Ints, Mask
from depthcli.core.result import DepthResult
from depthcli.kernels.jit import jit, run_bands
from depthcli.methods.kinect.camera_motion import MovedView, displacement, estimated_motion, view_after
from depthcli.methods.kinect.disparity import Measurement
from depthcli.methods.kinect.gap_filling import SHADOW_COST, passed
from depthcli.methods.kinect.layers import Layer
from depthcli.methods.kinect.pipeline import SequencePipeline
from depthcli.methods.kinect.pipeline.dsrm import Dsrm

_FILLED, _FALLBACK, _CARRIED = int(DepthStatus.GAP_FILLED), int(DepthStatus.FALLBACK), int(DepthStatus.CARRIED)

_MIN_CHANGED = 0.02  # with a smaller share of changed pixels no motion is estimated; noise alone changes fewer
_MIN_MOTION = 0.5  # pixels; a camera that moves less counts as still, since pixels keep their places
_MIN_GAIN = 0.02  # additional share of agreeing pixels that an estimated motion must bring


@dataclass(frozen=True)
class SequenceState:
    """State of a sequence after a frame."""

    layers: list[Layer]
    color: Image8  # (H, W, 3), the frame's color image
    disparity: Floats  # (H, W), refined, pixels, NaN = none
    noise: float  # standard deviation in the last segmented frame, pixels
    age: int  # frames since the last segmented frame
    pose: Doubles | None = None  # (4, 4), from camera to world coordinates, meters


class Sequence(SequencePipeline, Dsrm):
    """Refine the first frame like ``dsrm``; then let still pixels keep their segments, and refit the surfaces.

    Changed pixels join the segment that is nearest in color and depth. After too much change, or too many frames,
    segments are computed again. If the camera has moved, by the poses of both frames or by tracked corners, the
    segments are first projected into its new view, provided that more pixels then agree with the frame. Pixels that the
    projection does not reach count as changed. ``words["motion"]`` of the result is ``still``, ``pose``, ``estimated``,
    or ``new`` if segments were computed again.
    """

    renamed: ClassVar[dict[str, str]] = {"most_changed": "max_changed", "longest": "max_age"}

    color_change: int = Field(10, ge=0, le=255, description="largest change of a still pixel's color, grey levels")
    max_changed: float = Field(
        0.3, ge=0, le=1, description="share of changed pixels above which segments are computed again"
    )
    max_age: int = Field(30, ge=1, description="frames after which segments are computed again")
    drift: float = Field(1.0, ge=0, description="deviation of filled values per frame, multiples of the noise")

    def step(self, frame: RgbdFrame, state: SequenceState | None) -> tuple[DepthResult, SequenceState]:
        """Refine the next frame; ValueError if it has no depth, or another size than the previous frames."""
        if state is None:
            return self._start(frame)
        self.check_size(frame, state.color.shape[:2])
        clock = Clock()
        clock.start("unreliable")
        measurement = Measurement.of(frame, self.jump, self.min_probability, self.shadows, state.noise)
        clock.start("motion")
        motion, view, still = self._followed(frame, measurement, state)
        clock.start("model")
        if state.age + 1 >= self.max_age or 1 - still.mean() > self.max_changed:
            result, state = self._start(frame)
            clock.include(result.seconds)
            result.seconds = clock.seconds
            return result, state
        previous, layers = state.disparity, state.layers
        if view is not None:
            still &= view.certain
            # Shadows do not limit a surface that was seen before.
            measurement = replace(measurement, limit=np.where(still, np.float32(np.inf), measurement.limit))
            previous, layers = view.disparity, []
            for layer in state.layers:
                labels = np.where(view.reached, layer.labels.ravel()[view.source], np.int32(-1))
                own = view.reached & layer.own.ravel()[view.source]
                layers.append(Layer(labels, self.model(previous, labels, state.noise), own))
        carried = []
        for layer in layers:
            labels, own = carried_labels(layer, still, frame.color, measurement)
            carried.append(Layer(labels, self.model(measurement.reliable, labels, state.noise, layer.surfaces), own))
        clock.start("refinement")
        refined = self.combined(carried, measurement)
        drift = np.float32(self.drift * state.noise)
        run_bands(
            _blend, len(refined.disparity), refined.disparity, refined.scale, refined.status, previous, still, drift
        )
        clock.start("result")
        result = refined.to_depth(frame)
        result.seconds, result.words["motion"] = clock.seconds, motion
        result.figures = measurement.shadows.figures()
        return result, SequenceState(carried, frame.color, refined.disparity, state.noise, state.age + 1, frame.pose)

    def _start(self, frame: RgbdFrame) -> tuple[DepthResult, SequenceState]:
        """Refine the first frame of a sequence."""
        result, measurement, layers, disparity = self.refine(frame)
        result.words["motion"] = "new"
        return result, SequenceState(layers, frame.color, disparity, measurement.noise, 0, frame.pose)

    def _followed(
        self, frame: RgbdFrame, measurement: Measurement, state: SequenceState
    ) -> tuple[str, MovedView | None, Mask]:
        """Return ``still``, ``pose`` or ``estimated``, the previous frame's view, and the pixels that agree with it.

        The view is None if the camera has not moved, or if the motion does not make more pixels agree.
        """
        limits = self.color_change, self.tolerance * measurement.noise
        still = still_pixels(frame.color, measurement.reliable, state.color, state.disparity, *limits)
        agreed = float(still.mean())
        camera = frame.intrinsics or typical_intrinsics(frame.shape[1], frame.shape[0])
        way, min_gain, motion = "estimated", _MIN_GAIN, None
        if frame.pose is not None and state.pose is not None:
            way, min_gain, motion = "pose", 0, np.linalg.inv(frame.pose) @ state.pose
        elif 1 - agreed > _MIN_CHANGED:
            motion = estimated_motion(state.color, frame.color, state.disparity, camera, frame.fb)
        if motion is not None and displacement(motion, state.disparity, camera, frame.fb) >= _MIN_MOTION:
            view = view_after(motion, state.color, state.disparity, camera, frame.fb, measurement.jump)
            moved = still_pixels(frame.color, measurement.reliable, view.color, view.disparity, *limits) & view.reached
            if moved.sum() > (agreed + min_gain) * max(view.reached.sum(), 1):
                return way, view, moved
        return "still", None, still


@jit
def _blend(begin, end, disparity, scale, status, previous, still, drift):
    # Average filled values of still pixels with the previous values, whose variance grows by the drift.
    width = disparity.shape[1]
    for y in range(begin, end):
        for x in range(width):
            if (status[y, x] == _FILLED or status[y, x] == _FALLBACK) and still[y, x] and not np.isnan(previous[y, x]):
                variance = scale[y, x] * scale[y, x]
                weight, old_weight = np.float32(1) / variance, np.float32(1) / (variance + drift * drift)
                disparity[y, x] = (weight * disparity[y, x] + old_weight * previous[y, x]) / (weight + old_weight)
                status[y, x] = _CARRIED


def still_pixels(
    color: Image8, reliable: Floats, before: Image8, disparity: Floats, color_change: int, disparity_change: float
) -> Mask:
    """Select the pixels, (H, W) bool, whose color channels and disparity change by at most the given amounts.

    ``before`` and ``disparity`` belong to the previous frame. Without a reliable disparity in both frames, only color
    counts.
    """
    changes = cv2.absdiff(color, before)
    same_color = cv2.inRange(changes, np.zeros(3), np.full(3, float(color_change))) > 0
    return np.asarray(same_color & ~(np.abs(reliable - disparity) > np.float32(disparity_change)), np.bool_)


def carried_labels(layer: Layer, still: Mask, color: Image8, measurement: Measurement) -> tuple[Ints, Mask]:
    """Return labels and ``own`` of a layer in the next frame, both (H, W); ``measurement`` belongs to that frame.

    A still pixel keeps its segment, unless its reliable disparity is off the surface by more than a jump plus three
    scales, or the surface is nearer than its shadow allows by more than a jump. Other pixels take the segment at the
    end of the cheapest path through 8-neighbors. A step costs the absolute color differences, plus the distance of the
    surface from the reliable disparity in fifths of the noise, plus ``SHADOW_COST`` if the surface is nearer than
    the shadow allows. Two raster sweeps search the paths and may miss bent ones. The label is -1 if no path reaches a
    pixel.
    """
    cost, given = np.empty(still.shape, np.float32), (measurement.reliable, measurement.limit, layer.surfaces)
    run_bands(_held, len(cost), layer.labels, still, *given, np.float32(measurement.jump), cost)
    labels, own = np.where(cost > 0, np.int32(-1), layer.labels), layer.own.copy()
    pixels = np.argwhere(cost > 0).astype(np.int32)
    _sweep(pixels, cost, labels, own, color, *given, np.float32(5 / measurement.noise))
    return labels, own


@jit
def _held(begin, end, labels, still, reliable, limit, surfaces, jump, cost):
    # Set the cost to 0 at pixels that keep their segment, and to infinity elsewhere.
    width = labels.shape[1]
    for y in range(begin, end):
        for x in range(width):
            s = labels[y, x]
            cost[y, x] = np.inf
            if s < 0 or not still[y, x]:
                continue
            value = surface_at(surfaces, np.int64(s), float(y), float(x))
            off = abs(reliable[y, x] - value)
            if not off > jump + 3 * surfaces.scale[s] and not value > limit[y, x] + jump:  # False if unknown
                cost[y, x] = 0


@jit
def _sweep(pixels, cost, labels, own, color, reliable, limit, surfaces, weight):
    height, width = labels.shape
    for step in (1, -1):
        for y, x in pixels[::step]:
            for k in range(4):
                v, u = passed(y, x, step, k)
                if not (0 <= v < height and 0 <= u < width) or labels[v, u] < 0:
                    continue
                total = cost[v, u]
                for c in range(3):
                    total += np.float32(abs(np.int64(color[y, x, c]) - np.int64(color[v, u, c])))
                value = surface_at(surfaces, np.int64(labels[v, u]), float(y), float(x))
                apart = weight * np.float32(abs(reliable[y, x] - value))
                if not np.isnan(apart):
                    total += apart
                if value > limit[y, x]:
                    total += np.float32(SHADOW_COST)
                if total < cost[y, x]:
                    cost[y, x] = total
                    labels[y, x] = labels[v, u]
                    own[y, x] = own[v, u]
