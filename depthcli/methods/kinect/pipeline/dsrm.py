"""The thesis's refinement (chapter 4): surfaces fitted robustly to layers of depth-guided segments."""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.algorithms.segmentation import Segmentation
from depthcli.algorithms.segmentation.statistical_region_merging import StatisticalRegionMerging
from depthcli.core.cameras.triangulation import depth_of_disparity
from depthcli.core.frames import RgbdFrame
from depthcli.core.maps import DepthMap, DepthStatus
from depthcli.core.result import Clock
from depthcli.methods.kinect.layer import Evidence, Layer, Refined, combine, evidence, fit_layer, lab_of
from depthcli.methods.kinect.model import Model
from depthcli.methods.kinect.model.polynomial import Polynomial
from depthcli.methods.kinect.pipeline import KinectPipeline
from depthcli.methods.kinect.result import RefinedDepth
from depthcli.methods.kinect.suspects import jump_distance


class Dsrm(KinectPipeline):
    """Fit a polynomial in inverse depth to every segment of every layer, and trust it where the sensor errs.

    The band beside depth jumps is left out of the fit; afterwards its values are kept where they agree with
    the model. Segments of which too little is known join a neighbor of like color that fits the shadow they lie in.
    """

    segmentation: Segmentation = Field(
        default_factory=lambda: StatisticalRegionMerging(
            complexity=8192, coarser=(2048, 512), depth_guidance=4096, smoothing=0
        ),
        description="layers of segments, from fine to coarse",
    )
    model: Model = Field(default_factory=Polynomial, description="of the inverse depth in a segment")
    jump: float = Field(5.0, gt=0, le=1000, description="a larger step is a depth edge, multiples of the noise")
    row_band: int = Field(
        8, ge=0, le=64, description="suspects: pixels along the row on the near side of a depth edge, or beside a gap"
    )
    column_band: int = Field(2, ge=0, le=64, description="the same along the column")
    min_known: int = Field(30, ge=1, description="a segment's model needs so many known pixels")
    min_share: float = Field(0.05, ge=0, le=1, description="and this share of the segment")
    join: bool = Field(True, description="segments without a model join one that has one; false: bilateral filling")
    detail_reach: float = Field(
        3.0, ge=0, le=100, description="pixels over which residuals of known values are added to the model; 0: none"
    )
    tolerance: float = Field(3.0, gt=0, description="tau: a value that is off by more scales contradicts the model")
    smooth: bool = Field(True, description="replace values that agree with the model by it: less noise")
    combination: Literal["median", "in_turn"] = Field(
        "median", description="of the layers; in_turn: each fills and corrects what the finer ones left"
    )
    correction_band: int = Field(
        8, ge=0, le=64,
        description="in_turn: values that contradict the model are corrected so near to a depth edge or border, pixels",
    )  # fmt: skip
    details: bool = Field(False, description="write the segments of every layer as pictures")

    def __call__(self, frame: RgbdFrame) -> RefinedDepth:
        return self.refine(frame)[0]

    def refine(self, frame: RgbdFrame) -> tuple[RefinedDepth, Evidence, list[Layer], NDArray[np.float32]]:
        """The result, and what a sequence goes on with: evidence, layers (none of those in turn), disparity."""
        clock = Clock()
        seen = evidence(frame, self.jump, self.row_band, self.column_band)
        clock.stop("suspects")
        labels = self.segmentation.layers(frame.color, seen.trusted)
        clock.stop("segmentation")
        layers: list[Layer] = []
        if self.combination == "median":
            layers = self._fit(frame, seen, labels)
            clock.stop("model")
            refined = combine(layers, seen, self.detail_reach, self.tolerance, self.smooth)
        else:
            refined = self._in_turn(frame, seen, labels)
        refined = filled(refined, frame, seen)
        clock.stop("refinement")
        result = in_meters(refined, frame)
        if self.details:
            result.pictures |= {f"segments_{k}": segment_picture(layer) for k, layer in enumerate(labels)}
        clock.stop("result")
        result.seconds = clock.seconds
        return result, seen, layers, refined.disparity

    def _fit(self, frame: RgbdFrame, seen: Evidence, labels: list[NDArray[np.int32]]) -> list[Layer]:
        """The layers' surfaces."""
        lab = lab_of(frame.color)
        return [fit_layer(seen, each, lab, self.model, self.min_known, self.min_share, self.join) for each in labels]

    def _in_turn(self, frame: RgbdFrame, seen: Evidence, labels: list[NDArray[np.int32]]) -> Refined:
        """SPEC 4.3 C: each layer sees what the one before has filled and corrected."""
        lab = lab_of(frame.color)
        edge = jump_distance(seen.disparity, self.jump * seen.noise).inside(self.correction_band, self.correction_band)
        values, scale = seen.trusted.copy(), np.full(frame.shape, seen.noise, np.float32)
        status = np.where(np.isnan(values), np.uint8(DepthStatus.EMPTY), np.uint8(DepthStatus.KEPT))
        for each in labels:
            now = Evidence(seen.disparity, values, np.zeros(frame.shape, bool), seen.limit, seen.noise)
            layer = fit_layer(now, each, lab, self.model, self.min_known, self.min_share, self.join)
            surface, spread = layer.estimate(now, self.detail_reach)
            unknown = np.isnan(values)
            off = np.abs(values - surface) > self.tolerance * spread
            replaced = (unknown & ~np.isnan(surface)) | (off & (edge | _near_border(each, self.correction_band)))
            values = np.where(replaced, surface, values)
            scale = np.where(replaced, spread, scale)
            measured = ~np.isnan(seen.disparity)
            status[replaced & measured] = DepthStatus.CORRECTED
            status[replaced & ~measured] = DepthStatus.GAP_FILLED
        return Refined(values, scale, status)

    def peak_bytes(self, shape: tuple[int, int]) -> int:
        """Sums and pairs of the segmentation, or three maps a layer beside it."""
        return 160 * shape[0] * shape[1] + (64 << 20)


def _near_border(labels: NDArray[np.int32], reach: int) -> NDArray[np.bool_]:
    """(H, W) bool: at most ``reach`` pixels from another segment."""
    inner = np.ones(labels.shape, np.uint8)
    across, down = labels[:, 1:] != labels[:, :-1], labels[1:] != labels[:-1]
    inner[:, 1:][across] = inner[:, :-1][across] = 0
    inner[1:][down] = inner[:-1][down] = 0
    near: NDArray[np.bool_] = (inner == 0) if inner.all() else cv2.distanceTransform(inner, cv2.DIST_L2, 3) < reach
    return near


def filled(refined: Refined, frame: RgbdFrame, seen: Evidence) -> Refined:
    """What no surface reaches, from around."""
    missing = np.isnan(refined.disparity)
    if not missing.any():
        return refined
    from depthcli.methods.kinect.pipeline.joint_bilateral import joint_bilateral_fill

    values = joint_bilateral_fill(frame.color, refined.disparity)
    filled = missing & ~np.isnan(values)
    scale = np.where(filled, np.float32(seen.noise), refined.scale)
    status = np.where(filled, np.uint8(DepthStatus.FALLBACK), refined.status)
    return Refined(values, scale, status)


def in_meters(refined: Refined, frame: RgbdFrame) -> RefinedDepth:
    """The result; what was kept as it is keeps the sensor's own bits."""
    depth = depth_of_disparity(refined.disparity, frame.fb)
    same = refined.status == DepthStatus.KEPT
    depth[same] = frame.depth[same]
    status = np.where(np.isnan(depth), np.uint8(DepthStatus.EMPTY), refined.status)
    sigma: NDArray[np.float32] = (refined.scale * depth * depth / np.float32(frame.fb)).astype(np.float32)
    return RefinedDepth(depth=DepthMap(depth, status), sigma=sigma)


def segment_picture(labels: NDArray[np.int32]) -> NDArray[np.uint8]:
    """(H, W, 3) uint8, every label a color of its own that says nothing."""
    mixed = (labels.astype(np.uint32) + 1) * np.uint32(2654435761)
    return np.stack([(mixed >> np.uint32(shift)).astype(np.uint8) | 32 for shift in (8, 16, 24)], axis=2)
