"""Stereo of a color and an infrared camera: depth of surfaces that the sensor misses (thesis, section 5.1.1)."""

from __future__ import annotations

import itertools
from typing import Any, Literal, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.algorithms.filters import local_moments
from depthcli.core import memory
from depthcli.core.arrays import Floats, Image8, Mask
from depthcli.core.cameras.triangulation import depth_of_disparity, disparity_of_depth
from depthcli.core.frames import RgbIrFrame, SparseFrame, StereoPair
from depthcli.core.maps import DisparityMap
from depthcli.core.method import ConfigModel
from depthcli.core.result import Clock
from depthcli.kernels.jit import parallel_jit, prange
from depthcli.kernels.winners import left_right_difference, winners
from depthcli.methods.fusion import Fusion
from depthcli.methods.stereo.refinement.speckle_filter import SpeckleFilter
from depthcli.methods.stereo.segments.steps import SegmentSteps
from depthcli.methods.stereo.volume import CostVolume, RefinementContext

GREY = (0.299, 0.587, 0.114)
"""Weights of red, green and blue in the luma of ITU-R BT.601."""


_MAX_TILT = 0.3  # vertical over horizontal baseline, beyond which the rectified images would be turned too far
_MIN_OVERLAP = 0.05  # share of the rectified image that both cameras have to see, to be matched at all
_SINGLE = {"r": (1.0, 0.0, 0.0), "g": (0.0, 1.0, 0.0), "b": (0.0, 0.0, 1.0), "grey": GREY}
# Values that the presets were published with; nothing in the repository varies them.
_MEAN_WINDOW = 15  # side of the window whose mean is subtracted, pixels
_MIN_CORRESPONDENCES = 500  # pixels of known disparity that weights are fitted to; with fewer, those of grey
_STRIDE = 7  # every so many-th correspondence is used: neighbors are alike


# Measures that do not depend on the sensor's response, weighted by consensus (thesis, section 6.4.9).
_MEASURES: dict[str, Any] = {
    "measures": ["gradient", "rank", "census", "zncc"],
    "exponent": 6,
    "aggregation": {"method": "constant_window", "window": 7},
}
# Steps as of ``stereo segments``, but less smooth, and without cutting segments that lack structure.
_STEPS: dict[str, Any] = {
    "window_radius": 0,
    "optimization": {"method": "scanline", "p1": 0.3, "p2": 1.2},
    "planes": {"tolerance": 0.75, "min_size": 50, "flatness": 0.9, "flat": True, "max_planes": 150},
    "energy": {"data_term": "dedc", "truncation": 2, "color_scale": 50}
    | dict.fromkeys(("data_weight", "cost_weight", "visibility", "smoothness"), 10),
    "rounds": 2,
    "refinement": ["subpixel"],
}


class MatchSelection(ConfigModel):
    """Selection of the matches that are reliable.

    A match is compared with the sensor's disparity at its pixel:

    - it contradicts the sensor (they differ by more than ``tolerance``): it has to be cheaper by ``margin`` than the
      sensor's disparity, and no disparity that the sensor has within ``widening`` pixels: windows widen the foreground
      by half their size;
    - the sensor has no value: it has to be cheaper by ``blind_margin`` than the mean of the pixel's costs, and no
      disparity that the sensor has within ``widening`` pixels;
    - it confirms the sensor: it needs a share ``consensus`` of the votes around, and a ``texture``.

    Of the kept matches, regions smaller than ``speckle`` are removed.
    """

    margin: float = Field(
        0.15, ge=0, description="how much cheaper a contradicting match is than the sensor's, in units of one measure"
    )
    blind_margin: float = Field(
        0.1, ge=0, description="the same against the pixel's mean where the sensor has no depth"
    )
    consensus: float = Field(0.3, ge=0, le=1, description="share of votes that a match confirming the sensor needs")
    texture: float = Field(4.0, ge=0, description="standard deviation in 9 x 9 that such a match needs, grey levels")
    speckle: int = Field(50, ge=0, description="regions of similar disparity with fewer pixels are removed")
    widening: int = Field(5, ge=0, le=64, description="distance by which stereo may make a surface too wide, pixels")
    tolerance: float = Field(1.5, ge=0, description="largest difference that confirms the sensor, pixels")

    def __call__(
        self, dense: Floats, votes: Floats, sensor: Floats, volume: CostVolume, image: Image8
    ) -> tuple[Mask, Floats]:
        """Return the matches to keep, (H, W) bool, and the share of the margin by which they are cheaper, 0 .. 1.

        ``dense`` and ``sensor`` are disparities of the matches and of the sensor, pixels, ``votes`` the share of the
        votes around, ``volume`` the costs that the matches were found with, ``image`` (H, W) the left view.
        """
        known, agrees = np.isfinite(sensor), np.abs(dense - sensor) <= self.tolerance
        mean_cost = volume.costs.mean(axis=2, dtype=np.float32) / np.float32(volume.scale)
        gain = np.where(known, cost_at(volume, sensor), mean_cost) - cost_at(volume, dense)
        margin = np.where(known, self.margin, self.blind_margin)
        confirmed = agrees & (votes >= self.consensus) & (local_deviation(image) >= self.texture)
        # Widened: the sensor does not have the disparity there, but has it within ``widening`` pixels.
        height, width = dense.shape
        padded = np.pad(sensor, self.widening, constant_values=np.nan)
        near = np.zeros(dense.shape, np.bool_)
        for y in range(2 * self.widening + 1):
            for x in range(2 * self.widening + 1):
                near |= np.abs(padded[y : y + height, x : x + width] - dense) <= self.tolerance
        keep = confirmed | (~agrees & (gain > margin) & ~near)
        return keep, np.where(agrees, 0, np.clip(gain / np.maximum(margin, 1e-6), 0, 1)).astype(np.float32)


class CrossModalMatches(NamedTuple):
    """Disparities of a rectified color and infrared pair, (H, W), pixels."""

    dense: Floats  # of every pixel
    sparse: Floats  # of reliable matches, NaN elsewhere
    confidence: Floats  # in [0, 1], share of the votes around, or of the margin where that is more
    weights: tuple[float, float, float]  # of the red, green and blue channel; of late fusion 1/3 each


class CrossModal(ConfigModel):
    """Stereo of infrared and of color mixed to resemble it: fused costs, planes over segments, reliable matches."""

    channels: Literal["early", "late", "r", "g", "b", "grey"] = Field(
        "early", description="early: weighted by the sensor's depth; late: matched one by one; or one alone"
    )
    median: Literal[0, 3, 5] = Field(
        0, description="window of the median of the infrared image, against speckles, pixels; 0: none"
    )
    max_disparity: int | None = Field(
        None, ge=1, le=16383, description="largest disparity, pixels; null: a quarter more than the sensor's largest"
    )
    fusion: Fusion = Field(
        default_factory=lambda: Fusion.model_validate(_MEASURES),
        description="a config of fuse without its optimization",
    )
    structure: float = Field(4.0, gt=0, description="deviation in 9 x 9 below which costs fade, grey levels")
    planes: SegmentSteps = Field(
        default_factory=lambda: SegmentSteps.model_validate(_STEPS),
        description="planes over color segments, a config of stereo's segments",
    )
    selection: MatchSelection = Field(default_factory=MatchSelection, description="which matches are kept")

    def __call__(self, frame: RgbIrFrame, clock: Clock) -> tuple[SparseFrame, dict[str, float]]:
        """Return the frame with sparse depth in the color camera's pixels, and figures for the report.

        InputError where the rig's cameras lie one above the other, or have no common field of view.
        """
        clock.start("rectify")
        color, infrared, depth, fb, rectified = frame.color, frame.infrared, frame.depth, frame.fb, None
        if frame.rig is not None:
            size, infrared_size = ((image.shape[1], image.shape[0]) for image in (color, infrared))
            limits = {"max_tilt": _MAX_TILT, "min_overlap": _MIN_OVERLAP}
            rectified = frame.rig.rectified(size, infrared_size, -1, mirrored=True, **limits)
            color, infrared, _ = rectified.images(color, infrared, cv2.INTER_LINEAR, cv2.BORDER_REPLICATE)
            depth, fb = rectified.rectify_depth(depth), rectified.fb
        clock.start("stereo")
        turn = np.s_[:, ::-1] if rectified is not None and rectified.mirrored else np.s_[:, :]
        color, infrared = np.ascontiguousarray(color[turn]), np.ascontiguousarray(infrared[turn])
        matches = self.match(color, infrared, disparity_of_depth(depth[turn], fb))
        sparse, dense = (depth_of_disparity(values, fb)[turn] for values in (matches.sparse, matches.dense))
        confidence = matches.confidence[turn]
        if rectified is not None:
            sparse, confidence = rectified.unrectify_depth(sparse, confidence)
            dense, _ = rectified.unrectify_depth(dense, dense)
        figures = {f"weight_{name}": weight for name, weight in zip("rgb", matches.weights, strict=True)}
        figures["matched"] = float(np.mean(np.isfinite(sparse)))
        sparse, confidence, dense = (np.ascontiguousarray(part, np.float32) for part in (sparse, confidence, dense))
        given = frame.color, frame.depth, fb
        return SparseFrame(*given, sparse=sparse, sparse_confidence=confidence, dense=dense), figures

    def match(self, color: Image8, infrared: Image8, sensor: Floats) -> CrossModalMatches:
        """Return the disparities of a rectified pair; ``sensor`` is the sensor's depth as disparity, pixels."""
        if self.median:
            infrared = np.asarray(cv2.medianBlur(infrared, self.median), np.uint8)
        weights: tuple[float, float, float] = (1 / 3, 1 / 3, 1 / 3)
        if self.channels == "early":
            weights = learned_weights(color, infrared, sensor)
        elif self.channels != "late":
            weights = _SINGLE[self.channels]
        mixes = [mix_channels(color, weights)]
        if self.channels == "late":
            mixes = [np.ascontiguousarray(color[:, :, k]) for k in range(3)]
        known = sensor[np.isfinite(sensor)]
        largest = float(np.quantile(known, 0.999)) if known.size else 64.0
        top = self.max_disparity or int(np.clip(np.ceil(1.25 * largest) + 2, 16, max(16, sensor.shape[1] // 2)))
        pairs = [StereoPair(mix, infrared) for mix in mixes]
        fused = [self.fusion.fuse(pair, top) for pair in pairs]
        volume = fused[0].volume if len(fused) == 1 else _mean([part.volume for part in fused])
        volume = faded_costs(volume, mixes[0], infrared, self.structure)
        color_pair = StereoPair(color, np.repeat(infrared[:, :, None], 3, axis=2))
        dense = self.planes.from_volume(color_pair, volume, top, Clock()).disparity.values
        votes = [part.ballot.shares(np.rint(dense).astype(np.int32)[None])[0] for part in fused]
        confidence = np.asarray(np.mean(votes, axis=0), np.float32)
        keep, margin_share = self.selection(dense, confidence, sensor, volume, mixes[0])
        chosen = DisparityMap(np.where(keep, dense, np.float32(np.nan)), np.zeros(dense.shape, np.uint8))
        if self.selection.speckle:
            context = RefinementContext(pairs[0], volume, np.zeros(dense.shape, np.uint16))
            chosen = SpeckleFilter(size=self.selection.speckle)(chosen, context)
        return CrossModalMatches(dense, chosen.values, np.maximum(confidence, margin_share), weights)

    def peak_bytes(self, shape: tuple[int, int]) -> int:
        """Estimate of the peak working memory for a frame of ``shape``, in bytes."""
        top = self.max_disparity or shape[1] // 4
        # The faded costs and two sums of paths; with late fusion also the volumes of three channels.
        bytes_per_cell = 8 + (10 if self.channels == "late" else 0)
        return self.fusion.peak_bytes(shape, top) + bytes_per_cell * shape[0] * shape[1] * (top + 1)


def _mean(volumes: list[CostVolume]) -> CostVolume:
    # Mean of volumes of one scale, weighted at each pixel by the left-right agreement of its winners.
    total: NDArray[Any] = np.zeros(volumes[0].costs.shape, np.float32)
    weights = np.zeros(volumes[0].costs.shape[:2], np.float32)
    for volume in volumes:
        left, right = winners(volume.costs)
        trust = (1 / (1 + np.minimum(left_right_difference(left, right), np.float32(1e3)))).astype(np.float32)
        total += trust[:, :, None] * volume.costs
        weights += trust
    costs = np.rint(total / weights[:, :, None]).astype(np.uint16)
    return CostVolume(np.ascontiguousarray(costs), volumes[0].scale)


def learned_weights(color: Image8, infrared: Image8, disparity: Floats) -> tuple[float, float, float]:
    """Fit the weights of the color channels whose mix best follows the infrared image, >= 0 and with sum 1.

    Both are taken without their local mean, so that only structure counts; least squares without negative weights
    (Chiu et al., BMVC 2011: early fusion). Where the sensor, whose ``disparity`` is given, knows too few pixels, the
    weights of grey.
    """
    rows, columns = np.nonzero(np.isfinite(disparity))
    matched = np.rint(columns - disparity[rows, columns]).astype(np.int64)
    inside = (matched >= 0) & (matched < color.shape[1])
    rows, columns, matched = (part[inside][::_STRIDE] for part in (rows, columns, matched))
    if rows.size * _STRIDE < _MIN_CORRESPONDENCES:
        return GREY
    structure = _structure(color)[rows, columns].astype(np.float64)
    target = _structure(infrared)[rows, matched].astype(np.float64)
    # Least squares over weights >= 0: the best of the solutions on every subset of the channels.
    normal, right = structure.T @ structure, structure.T @ target
    weights, lowest = np.zeros(3), 0.0
    for subset in itertools.chain(*(itertools.combinations(range(3), n) for n in (1, 2, 3))):
        chosen = list(subset)
        part = normal[np.ix_(chosen, chosen)]
        values = np.linalg.lstsq(part, right[chosen], rcond=None)[0]
        cost = float(values @ part @ values - 2 * values @ right[chosen])
        if (values >= 0).all() and cost < lowest:
            weights, lowest = np.zeros(3), cost
            weights[chosen] = values
    total = float(weights.sum())
    if total <= 0:
        return GREY
    red, green, blue = (float(w) / total for w in weights)
    return red, green, blue


def mix_channels(color: Image8, weights: tuple[float, ...]) -> Image8:
    """Return the weighted sum of the channels of (H, W, 3) ``color``, (H, W) uint8."""
    mix = color.astype(np.float32) @ np.asarray(weights, np.float32)
    return np.clip(np.rint(mix), 0, 255).astype(np.uint8)


def _structure(image: Image8) -> Floats:
    wide = image.astype(np.float32)
    return np.asarray(wide - cv2.blur(wide, (_MEAN_WINDOW, _MEAN_WINDOW)), np.float32)


def local_deviation(image: Image8) -> Floats:
    """Compute the standard deviation of grey levels in 9 x 9, (H, W) float32."""
    return np.asarray(np.sqrt(local_moments(image.astype(np.float32), 9)[1]), np.float32)


def faded_costs(volume: CostVolume, left: Image8, right: Image8, structure_threshold: float) -> CostVolume:
    """Fade costs towards the pixel's mean cost as far as one of the two windows lacks structure.

    Order, rank and correlation of a flat window are those of its noise, and saturated windows are all alike: such
    costs would outweigh those of the few pixels at the outlines. Costs, now uint16 of the same scale, are kept from a
    standard deviation of ``structure_threshold`` in 9 x 9 on, grey levels, > 0.
    """
    threshold = np.float32(structure_threshold)
    shares = [np.minimum(local_deviation(image) / threshold, np.float32(1)) for image in (left, right)]
    out: NDArray[np.uint16] = memory.empty(volume.costs.shape, np.uint16)
    _fade(volume.costs, shares[0], shares[1], out)
    return CostVolume(out, volume.scale)


def cost_at(volume: CostVolume, disparity: Floats) -> Floats:
    """Return the lower of the costs beside a disparity, (H, W) float32, in units of the measure; NaN = unknown.

    Disparities are clipped to the range of the volume.
    """
    max_disparity = np.float32(volume.n_disparities - 1)
    low = np.floor(np.clip(np.nan_to_num(disparity), 0, max_disparity)).astype(np.int64)
    rows, columns = np.ogrid[: low.shape[0], : low.shape[1]]
    beside = [volume.costs[rows, columns, np.minimum(low + step, volume.n_disparities - 1)] for step in (0, 1)]
    costs = np.minimum(*beside).astype(np.float32) / np.float32(volume.scale)
    return np.where(np.isfinite(disparity), costs, np.float32(np.nan))


@parallel_jit
def _fade(costs, left, right, out):
    height, width, n_disparities = costs.shape
    half = np.float32(0.5)
    for y in prange(height):
        # Mirrored, so that a pixel's right shares run with its disparities; 1 outside the image.
        mirror = np.ones(width + n_disparities, np.float32)
        for x in range(width):
            mirror[width - 1 - x] = right[y, x]
        for x in range(width):
            source, target = costs[y, x], out[y, x]
            shares = mirror[width - 1 - x : width - 1 - x + n_disparities]
            total = np.uint32(0)
            for i in range(source.size):
                total += np.uint32(source[i])
            mean = np.float32(total) / np.float32(source.size)
            own = left[y, x]
            for i in range(source.size):
                share = min(own, shares[i])
                target[i] = np.uint16(np.int32(mean + share * (np.float32(source[i]) - mean) + half))
