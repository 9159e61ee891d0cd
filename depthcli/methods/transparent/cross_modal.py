"""Stereo with a color and an infrared camera: depth of surfaces that the sensor misses (thesis, section 5.1.1)."""

from __future__ import annotations

import itertools
from typing import Any, Literal, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.core import memory
from depthcli.core.cameras.triangulation import depth_of_disparity, disparity_of_depth
from depthcli.core.color_and_infrared import RgbIrFrame
from depthcli.core.context import Clock
from depthcli.core.frames import SparseFrame, StereoPair
from depthcli.core.maps import Floats, Image8
from depthcli.core.method import ConfigModel
from depthcli.kernels.jit import jit, run_bands
from depthcli.kernels.winners import left_right_difference, winners
from depthcli.methods.fusion.pipeline import Fusion
from depthcli.methods.stereo.search_range import MAX_DISPARITY
from depthcli.methods.stereo.segments.steps import SegmentSteps
from depthcli.methods.stereo.volume import CostVolume
from depthcli.methods.transparent.match_selection import MatchSelection, local_deviation

Weights = tuple[float, float, float]
"""Weights of the red, green and blue channel."""
GREY: Weights = (0.299, 0.587, 0.114)
"""Weights of red, green and blue in the luma of ITU-R BT.601."""
# Values of the published presets; nothing in the repository varies them.
_MEAN_WINDOW = 15  # side of the window whose mean is subtracted, pixels
_MIN_CORRESPONDENCES = 500  # pixels of known disparity that a fit of weights needs; otherwise ``GREY`` is used
_STRIDE = 7  # every seventh correspondence is used: neighbors are similar
_MAX_TILT = 0.3  # largest vertical / horizontal baseline: beyond it, rectified images would be turned too far
_MIN_OVERLAP = 0.05  # smallest share of the rectified image that both cameras see
_SINGLE = {"r": (1.0, 0.0, 0.0), "g": (0.0, 1.0, 0.0), "b": (0.0, 0.0, 1.0), "grey": GREY}
# Measures that do not depend on the sensor's response, weighted by consensus (thesis, section 6.4.9).
_MEASURES: dict[str, Any] = {
    "measures": ["gradient", "rank", "census", "zncc"],
    "exponent": 6,
    "aggregation": {"method": "constant_window", "window": 7},
}
# Steps of ``stereo segments``, but less smooth, and without splitting segments that lack structure.
_STEPS: dict[str, Any] = {
    "segmentation": "mean_shift_rgb",
    "window_radius": 0,
    "optimization": {"method": "scanline", "p1": 0.3, "p2": 1.2},
    "planes": {"tolerance": 0.75, "min_size": 50, "flatness": 0.9, "flat": True, "max_planes": 150},
    "energy": {"data_term": "dedc", "truncation": 2, "boundary": {"method": "gaussian", "color_scale": 50}}
    | dict.fromkeys(("data_weight", "cost_weight", "visibility", "smoothness"), 10),
    "rounds": 2,
    "refinement": ["subpixel"],
}


class CrossModalMatches(NamedTuple):
    """Disparities of a rectified color and infrared pair, (H, W), pixels."""

    dense: Floats  # all pixels
    sparse: Floats  # reliable matches, NaN elsewhere
    confidence: Floats  # in [0, 1], share of the votes around or of the margin, whichever is larger
    weights: Weights  # of the red, green and blue channel; 1/3 each for late fusion


class CrossModal(ConfigModel):
    """Stereo of infrared and color, mixed to resemble infrared: fused costs, planes over segments, reliable matches."""

    channels: Literal["early", "late", "r", "g", "b", "grey"] = Field(
        "early",
        description="early: mixed, with weights fitted at the sensor's depth; late: matched one by one; or one alone",
    )
    median: Literal[0, 3, 5] = Field(
        0, description="window of the median of the infrared image, against speckles, pixels; 0: none"
    )
    max_disparity: int | None = Field(
        None,
        ge=1,
        le=MAX_DISPARITY,
        description="largest disparity, pixels; null: a quarter more than the sensor's largest",
    )
    fusion: Fusion = Field(
        default_factory=lambda: Fusion.model_validate(_MEASURES),
        description="a config of fuse without its optimization",
    )
    structure: float = Field(
        4.0, gt=0, description="standard deviation in 9 x 9 windows below which costs fade, grey levels"
    )
    planes: SegmentSteps = Field(
        default_factory=lambda: SegmentSteps.model_validate(_STEPS),
        description="planes over color segments, a config of stereo's segments",
    )
    selection: MatchSelection = Field(default_factory=MatchSelection, description="which matches are kept")

    def __call__(self, frame: RgbIrFrame, clock: Clock) -> tuple[SparseFrame, dict[str, float]]:
        """Return the frame with sparse depth in the color camera's pixels, and figures for the report.

        InputError if one of the rig's cameras is above the other, or if they have no common field of view.
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
        """Return the disparities of a rectified pair; ``sensor`` is the sensor's disparity, pixels."""
        if self.median:
            infrared = np.asarray(cv2.medianBlur(infrared, self.median), np.uint8)
        weights, mixes = self._mixes(color, infrared, sensor)
        known = sensor[np.isfinite(sensor)]
        largest = float(np.quantile(known, 0.999)) if known.size else 64.0
        top = self.max_disparity or int(np.clip(np.ceil(1.25 * largest) + 2, 16, max(16, sensor.shape[1] // 2)))
        pairs = [StereoPair(mix, infrared) for mix in mixes]
        fused = [self.fusion.fuse(pair, top) for pair in pairs]
        volume = faded_costs(_mean([part.volume for part in fused]), mixes[0], infrared, self.structure)
        color_pair = StereoPair(color, np.repeat(infrared[:, :, None], 3, axis=2))
        dense = self.planes.from_volume(color_pair, volume, top, Clock()).disparity.values
        votes = [
            part.ballot.shares(np.rint(dense).astype(np.int32)[None])[0] for part in fused if part.ballot is not None
        ]
        confidence = np.asarray(np.mean(votes, axis=0), np.float32)
        sparse, margin_share = self.selection(dense, confidence, sensor, volume, pairs[0])
        return CrossModalMatches(dense, sparse, np.maximum(confidence, margin_share), weights)

    def _mixes(self, color: Image8, infrared: Image8, sensor: Floats) -> tuple[Weights, list[Image8]]:
        """Return the weights of red, green and blue, and their mix; for late fusion, the channels one by one."""
        if self.channels == "late":
            return (1 / 3, 1 / 3, 1 / 3), [np.ascontiguousarray(color[:, :, k]) for k in range(3)]
        weights = learned_weights(color, infrared, sensor) if self.channels == "early" else _SINGLE[self.channels]
        return weights, [mix_channels(color, weights)]

    def peak_bytes(self, shape: tuple[int, int]) -> int:
        """Estimate the peak working memory for a frame of ``shape``, in bytes."""
        top = self.max_disparity or shape[1] // 4
        # The faded costs and two sums of paths; with late fusion also the volumes of three channels.
        bytes_per_cell = 8 + (10 if self.channels == "late" else 0)
        return self.fusion.peak_bytes(shape, top) + bytes_per_cell * shape[0] * shape[1] * (top + 1)


def _mean(volumes: list[CostVolume]) -> CostVolume:
    # Return the mean of volumes with equal scale, weighted at each pixel by the left-right agreement of its winner.
    if len(volumes) == 1:
        return volumes[0]
    total: NDArray[Any] = np.zeros(volumes[0].costs.shape, np.float32)
    weights = np.zeros(volumes[0].costs.shape[:2], np.float32)
    for volume in volumes:
        left, right = winners(volume.costs)
        trust = (1 / (1 + np.minimum(left_right_difference(left, right), np.float32(1e3)))).astype(np.float32)
        total += trust[:, :, None] * volume.costs
        weights += trust
    costs = np.rint(total / weights[:, :, None]).astype(np.uint16)
    return CostVolume(np.ascontiguousarray(costs), volumes[0].scale)


def faded_costs(volume: CostVolume, left: Image8, right: Image8, structure_threshold: float) -> CostVolume:
    """Return costs faded towards each pixel's mean cost if one of the two windows lacks structure.

    Order, rank and correlation of a flat window come from its noise, and saturated windows are all alike. Such costs
    would outweigh the costs of the few pixels at outlines. Costs are kept if the standard deviations in 9 x 9 are at
    least ``structure_threshold`` > 0, grey levels. The result is uint16, of the same scale.
    """
    threshold = np.float32(structure_threshold)
    shares = [np.minimum(local_deviation(image) / threshold, np.float32(1)) for image in (left, right)]
    out: NDArray[np.uint16] = memory.empty(volume.costs.shape, np.uint16)
    run_bands(_fade, len(volume.costs), volume.costs, shares[0], shares[1], out)
    return CostVolume(out, volume.scale)


@jit
def _fade(begin, end, costs, left, right, out):
    _, width, n_disparities = costs.shape
    half = np.float32(0.5)
    for y in range(begin, end):
        # Mirrored, so that the right image's shares are in the order of a pixel's disparities; 1 outside the image.
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


def learned_weights(color: Image8, infrared: Image8, disparity: Floats) -> Weights:
    """Fit the weights of the color channels whose mix best follows the infrared image, >= 0 and with sum 1.

    The local means of both images are subtracted, so that only structure counts. The fit is non-negative least squares
    (Chiu et al., BMVC 2011: early fusion) over pixels with a known sensor ``disparity``. If there are too few, or no
    channel follows the infrared image, the result is ``GREY``.
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


def mix_channels(color: Image8, weights: Weights) -> Image8:
    """Return the weighted sum of the channels of (H, W, 3) ``color``, (H, W) uint8."""
    mix = color.astype(np.float32) @ np.asarray(weights, np.float32)
    return np.clip(np.rint(mix), 0, 255).astype(np.uint8)


def _structure(image: Image8) -> Floats:
    wide = image.astype(np.float32)
    return np.asarray(wide - cv2.blur(wide, (_MEAN_WINDOW, _MEAN_WINDOW)), np.float32)
