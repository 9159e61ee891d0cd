"""Robust surfaces fitted to layers of depth-guided segments (thesis, chapter 4)."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import cv2
import numpy as np
from pydantic import Field

from depthcli.algorithms.filters import JointBilateral, beside_steps
from depthcli.algorithms.plane_fitting.polynomials import Polynomial
from depthcli.algorithms.segmentation import Segmentation
from depthcli.algorithms.segmentation.statistical_region_merging import StatisticalRegionMerging
from depthcli.core.context import Clock
from depthcli.core.frames import RgbdFrame
from depthcli.core.maps import DepthStatus, Floats, Ints
from depthcli.core.result import DepthResult
from depthcli.methods.kinect.depth_edges import near_side
from depthcli.methods.kinect.disparity import Measurement
from depthcli.methods.kinect.layers import Layer, RefinedDisparity, join_segments
from depthcli.methods.kinect.pipeline import KinectPipeline
from depthcli.methods.kinect.shadows import SHADOW_SIDES, Side

_MIN_CORE_PIXELS = 5  # core pixels that a segment needs for a fit to them; value of the shipped presets, not varied


class Dsrm(KinectPipeline):
    """Fit a polynomial in inverse depth to every segment of every layer, and use it where the sensor is unreliable.

    The fit leaves out unreliable pixels next to depth edges. Their values are kept if they agree with the model.
    Segments with too few known pixels join a neighbor of similar color that their shadow allows.
    """

    segmentation: Segmentation = Field(
        default_factory=lambda: StatisticalRegionMerging(
            complexity=8192, coarser=(2048, 512), depth_guidance=4096, smoothing=0
        ),
        description="layers of segments, from fine to coarse",
    )
    model: Polynomial = Field(Polynomial(), description="model that is fitted to the inverse depth of a segment")
    jump: float = Field(5.0, gt=0, le=1000, description="a larger step is a depth edge, multiples of the noise")
    min_probability: float = Field(
        0.8, ge=0, lt=1, description="measurements with a smaller probability of being correct are unreliable; 0: none"
    )
    shadows: bool | Side = Field(True, description=SHADOW_SIDES)
    min_known: int = Field(30, ge=1, description="number of known pixels of a segment that a model needs")
    min_share: float = Field(0.05, ge=0, le=1, description="share of a segment that has to be known for a model")
    join: bool = Field(True, description="segments without a model join one that has one; false: bilateral filling")
    detail_reach: float = Field(3.0, ge=0, le=100, description="reach of residuals added to the model, pixels; 0: none")
    tolerance: float = Field(
        3.0, gt=0, description="tau: values that differ by more contradict the model, multiples of the scale of its fit"
    )
    smooth: bool = Field(True, description="also replace values that agree with the model, which removes noise")
    combination: Literal["median", "in_turn"] = Field(
        "median", description="median of the layers; in_turn: each layer corrects the result of the finer layers"
    )
    correction_band: int = Field(
        8, ge=0, le=64, description="in_turn: largest distance of corrections from edges, pixels"
    )
    details: bool = Field(False, description="write the segments of every layer as pictures")

    def __call__(self, frame: RgbdFrame) -> DepthResult:
        return self.refine(frame)[0]

    def refine(self, frame: RgbdFrame) -> tuple[DepthResult, Measurement, list[Layer], Floats]:
        """Return the result and the state of a sequence: measurement, layers (none ``in_turn``), disparity."""
        clock = Clock()
        clock.start("unreliable")
        measurement = Measurement.of(frame, self.jump, self.min_probability, self.shadows)
        refined, labels, layers = self.surfaces(frame, measurement, clock)
        clock.start("result")
        result = refined.to_depth(frame)
        if self.details:
            for k, layer in enumerate(labels):  # an arbitrary color for every label
                mixed = (layer.astype(np.uint32) + 1) * np.uint32(2654435761)
                channels = [(mixed >> np.uint32(shift)).astype(np.uint8) | 32 for shift in (8, 16, 24)]
                result.pictures[f"segments_{k}"] = np.stack(channels, axis=2)
        result.seconds = clock.seconds
        result.figures = measurement.shadows.figures()
        return result, measurement, layers, refined.disparity

    def surfaces(
        self, frame: RgbdFrame, measurement: Measurement, clock: Clock
    ) -> tuple[RefinedDisparity, list[Ints], list[Layer]]:
        """Return the refined disparity, the labels of every layer of segments, and the layers (none ``in_turn``)."""
        clock.start("segmentation")
        labels = self.segmentation.layers(frame.color, measurement.reliable)
        if self.combination == "in_turn":
            clock.start("refinement")
            return self._in_turn(frame, measurement, labels), labels, []
        clock.start("model")
        layers = [self._fit(measurement, layer) for layer in labels]
        clock.start("refinement")
        return self.combined(layers, measurement), labels, layers

    def combined(self, layers: list[Layer], measurement: Measurement) -> RefinedDisparity:
        """Return the disparity computed from all layers."""
        return RefinedDisparity.of(layers, measurement, self.detail_reach, self.tolerance, self.smooth)

    def _fit(self, measurement: Measurement, labels: Ints) -> Layer:
        """Fit the model to the segments ``labels`` (H, W); segments that it cannot be fitted to join others.

        If a segment has too few reliable pixels and mostly ``core`` pixels, the model is fitted to its core pixels.
        """
        n = int(labels.max()) + 1
        size, reliable, measured, core = (
            np.bincount(labels[chosen].ravel(), minlength=n)
            for chosen in (..., ~np.isnan(measurement.reliable), ~np.isnan(measurement.disparity), measurement.core)
        )
        modelled = (reliable >= self.min_known) & (reliable >= self.min_share * size)
        by_core = ~modelled & (core >= _MIN_CORE_PIXELS) & (2 * core >= measured)
        values = np.where(by_core[labels] & measurement.core, measurement.disparity, measurement.reliable)
        surfaces = self.model(values, labels, measurement.noise)
        modelled |= by_core
        if self.join:
            owners = join_segments(labels, modelled, surfaces, measurement.lab, measurement.limit)
        else:
            owners = np.where(modelled, np.arange(n, dtype=np.int32), np.int32(-1))
        return Layer(owners[labels], surfaces, modelled[labels])

    def _in_turn(self, frame: RgbdFrame, measurement: Measurement, layers: list[Ints]) -> RefinedDisparity:
        """Fill and correct layer after layer, each fitted to the result of the finer layers (thesis, chapter 4).

        A joint bilateral filter fills the pixels that no surface reaches.
        """
        band, shape = self.correction_band, frame.shape
        edge = near_side(measurement.disparity, measurement.jump, band, band)
        values, scale = measurement.reliable.copy(), np.full(shape, measurement.noise, np.float32)
        status = np.where(np.isnan(values), np.uint8(DepthStatus.EMPTY), np.uint8(DepthStatus.KEPT))
        known = ~np.isnan(measurement.disparity)
        for labels in layers:
            finer = replace(measurement, reliable=values, core=np.zeros(shape, bool))
            surface, spread = self._fit(finer, labels).estimate(values, self.detail_reach)
            off = np.abs(values - surface) > self.tolerance * spread
            border = beside_steps(labels[:, 1:] != labels[:, :-1], labels[1:] != labels[:-1])
            if border.any():
                border = cv2.distanceTransform((~border).astype(np.uint8), cv2.DIST_L2, 3) < band
            replaced = (np.isnan(values) & ~np.isnan(surface)) | (off & (edge | border))
            values, scale = np.where(replaced, surface, values), np.where(replaced, spread, scale)
            status[replaced & known] = DepthStatus.CORRECTED
            status[replaced & ~known] = DepthStatus.GAP_FILLED
        missing = np.isnan(values)
        if missing.any():
            values = JointBilateral().fill(frame.color, values)
            filled = missing & ~np.isnan(values)
            scale[filled], status[filled] = measurement.noise, DepthStatus.FALLBACK
        return RefinedDisparity(values, scale, status)

    def peak_bytes(self, shape: tuple[int, int]) -> int:
        """Estimate the peak working memory for a frame of ``shape``, in bytes: the segmentation or the layers' maps."""
        return 160 * shape[0] * shape[1] + (64 << 20)
