"""Depth maps of one view: errors in millimeters and relative to the depth, by region."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.cameras.triangulation import disparity_of_depth
from depthcli.core.errors import InputError
from depthcli.data.formats.depth import read_depth
from depthcli.data.formats.disparity import read_plane
from depthcli.data.formats.pictures import DEPTH_STATUS_PALETTE
from depthcli.data.scenes import Scene
from depthcli.data.scenes.rgbd import RgbdScene, RgbdTruth
from depthcli.evaluation.pictures import LEGEND_TEXT, error_picture
from depthcli.evaluation.protocols import Protocol
from depthcli.evaluation.scores import ESTIMATED_ONLY, Measure, Score, Tally

Depth = NDArray[np.float32]

_RATIOS = (1.05, 1.10, 1.25, 1.25**2, 1.25**3)
_WRONG = 1.05  # ratio beyond which a pixel is shown as wrong
_METERS = (".pfm", ".npy")
_EITHER = (".tif", ".tiff")  # codes, or meters


@dataclass(frozen=True)
class DepthTruth:
    """True depth, ready to be compared with.

    Attributes
    ----------
    depth : (H, W) float32, meters, NaN = unknown
    regions : name -> (H, W) bool, pixels with known truth
    fb : focal length x baseline, pixel meters, or None
    scale : codes a meter of the truth's files
    """

    depth: Depth
    regions: dict[str, NDArray[np.bool_]]
    fb: float | None
    scale: float


class DepthProtocol(Protocol[Depth, DepthTruth]):
    """Mean and root-mean-square errors, relative errors, and shares of pixels within a ratio of the truth.

    The measures are those of the depth completion literature: MAE and RMSE in millimeters, REL the mean of
    ``|z - z_true| / z_true``, and delta, the percentage of pixels with ``max(z / z_true, z_true / z)`` below 1.05, 1.10
    and 1.25 (ClearGrasp's ``eval_depth_completion.py``, TransCG's ``utils/metrics.py``) and below 1.25 squared and
    cubed (the convention of NYU). Where the sensor's focal length x baseline is known, ``MAE px`` and ``bad 1 px``
    are the same errors in pixels of its disparity. All are over the pixels that have an estimate; ``coverage`` says
    how many have none.
    """

    title = "Depth: mean absolute error, mm; estimated pixels only"
    unit = "mm"
    note = "MAE, RMSE: mm; REL, delta: of the true depth; px: of the sensor's disparity; coverage: pixels with a value"
    kind = RgbdScene
    places = ("{scene}/depth", "{scene}")
    suffixes = (".pfm", ".npy", ".png", ".pgm", ".tif", ".tiff")
    mask_order = ("all", "gap", "occluded", "specular", "mismatch", "measured", "object", "transparent")
    legend = LEGEND_TEXT
    quantity = "depth"
    threshold_axis = "ratio to the truth"
    palette = DEPTH_STATUS_PALETTE
    takes = ("scale", "threshold", "resize")
    mae = Measure("MAE", "mm", convention=ESTIMATED_ONLY)

    @property
    def headline(self) -> Measure:
        """The mean absolute error."""
        return self.mae

    def truth(self, scene: Scene) -> DepthTruth:
        """True depth with its regions, at the size of the settings."""
        stored = scene.truth()
        if not isinstance(stored, RgbdTruth):
            raise InputError(f"{scene.folder}: {scene.name} has no true depth, which {self.name} scores")
        depth = self._resized(stored.depth)
        known = np.isfinite(depth)
        if not known.any():
            raise InputError(f"{scene.folder}: the true depth of {scene.name} has no known pixel")
        masks = {name: self._resized(mask.astype(np.uint8)) > 0 for name, mask in stored.masks.items()}
        regions = {"all": known, **{name: mask & known for name, mask in masks.items()}}
        scale = getattr(scene, "depth_scale", 1000.0)
        return DepthTruth(depth, {name: regions[name] for name in self.ordered(regions)}, stored.fb, scale)

    def single(self, truth: Path) -> Scene:
        """A depth map alone, without masks."""
        scale = self.settings.scale or 1000.0
        return RgbdScene(
            name=truth.stem, folder=truth.parent, protocol=self.name, color=truth, depth=truth, depth_true=truth,
            depth_scale=scale,
        )  # fmt: skip

    def read(self, path: Path, scene: Scene, truth: DepthTruth) -> Depth:
        """The map in meters; integer codes have the truth's scale where the settings have none."""
        suffix = path.suffix.lower()
        meters = suffix in _METERS or (suffix in _EITHER and read_plane(path).dtype.kind == "f")
        scale = None if meters else self.settings.scale or truth.scale
        estimate = self._resized(read_depth(path, scale))
        if estimate.shape != truth.depth.shape:
            have, want = (f"{a.shape[1]} x {a.shape[0]}" for a in (estimate, truth.depth))
            raise InputError(f"{path}: the map is {have}, the truth {want}; --resize brings both to one size")
        return estimate

    def _resized(self, array: NDArray[Any]) -> NDArray[Any]:
        if self.settings.resize is None:
            return array
        resized: NDArray[Any] = cv2.resize(array, self.settings.resize, interpolation=cv2.INTER_NEAREST)
        return resized

    def nothing(self, truth: DepthTruth) -> Depth:
        """A map of NaN."""
        return np.full_like(truth.depth, np.nan)

    def regions(self, truth: DepthTruth) -> dict[str, NDArray[np.bool_]]:
        """The masks, where the truth is known."""
        return truth.regions

    def error(self, estimate: Depth, truth: DepthTruth) -> NDArray[np.float64]:
        """(H, W) float64, millimeters."""
        return 1000.0 * np.abs(estimate.astype(np.float64) - truth.depth)

    def values(self, estimate: Depth, truth: DepthTruth) -> NDArray[np.floating[Any]]:
        """(H, W) float64, millimeters."""
        return 1000.0 * estimate.astype(np.float64)

    def true_values(self, truth: DepthTruth) -> NDArray[np.floating[Any]]:
        """(H, W) float64, millimeters."""
        return 1000.0 * truth.depth.astype(np.float64)

    def wrong(self, estimate: Depth, truth: DepthTruth) -> NDArray[np.bool_]:
        """Pixels off by more than 5 %, or by more than the settings' threshold in mm."""
        if self.settings.threshold is not None:
            far: NDArray[np.bool_] = self.error(estimate, truth) > self.settings.threshold
            return far
        wrong: NDArray[np.bool_] = _ratio(estimate, truth.depth) >= _WRONG
        return wrong

    def dense(self, estimate: Depth, truth: DepthTruth) -> list[Score]:
        """Delta at ratios up to 1.5."""
        name, region = next(iter(truth.regions.items()))
        tally = Tally(name, self.error(estimate, truth)[region])
        inside = _ratio(estimate, truth.depth)[region][~np.isnan(tally.error)]
        return [_delta(tally, inside, 1 + k / 100) for k in range(1, 51)]

    def picture(self, estimate: Depth, truth: DepthTruth) -> NDArray[np.uint8]:
        """(H, W, 3) RGB: right and wrong by the ratio 1.05."""
        return error_picture(estimate, self.wrong(estimate, truth), truth.regions["all"])

    def scores(self, estimate: Depth, truth: DepthTruth) -> list[Score]:
        """Every measure in every region."""
        error, ratio = self.error(estimate, truth), _ratio(estimate, truth.depth)
        pixels = None
        if truth.fb is not None:
            pixels = np.abs(disparity_of_depth(estimate, truth.fb) - disparity_of_depth(truth.depth, truth.fb))
        scores: list[Score] = []
        for name, region in truth.regions.items():
            tally = Tally(name, error[region])
            valid = tally.valid
            mean, square = (float(v.mean()) if v.size else np.nan for v in (valid, valid * valid))
            relative = (error[region] / (1000.0 * truth.depth[region]))[~np.isnan(tally.error)]
            scores += [
                tally.number(self.mae, mean, valid.size),
                tally.number(replace(self.mae, metric="RMSE"), float(np.sqrt(square)), valid.size),
                tally.number(
                    Measure("REL", "", convention=ESTIMATED_ONLY), float(relative.mean()) if valid.size else np.nan,
                    valid.size,
                ),
            ]  # fmt: skip
            inside = ratio[region][~np.isnan(tally.error)]
            scores += [_delta(tally, inside, limit) for limit in _RATIOS]
            if pixels is not None:
                off = pixels[region][~np.isnan(tally.error)]
                in_pixels = Measure("MAE", "px", convention=ESTIMATED_ONLY, label="MAE px")
                scores.append(tally.number(in_pixels, float(off.mean()) if off.size else np.nan, off.size))
                bad = Measure("bad", "%", 1.0, ESTIMATED_ONLY, label="bad 1 px")
                scores.append(tally.rate(bad, off > 1.0))
            coverage = Measure("coverage", "%", worst=0.0, larger_is_better=True)
            scores.append(tally.number(coverage, tally.density, tally.error.size))
        return scores


def _delta(tally: Tally, ratios: NDArray[np.float64], limit: float) -> Score:
    """Percentage of the estimated pixels, whose ratios are given, within a ratio of the truth."""
    measure = Measure("delta", "%", round(limit, 4), ESTIMATED_ONLY, larger_is_better=True, label=f"delta {limit:.4g}")
    return tally.number(measure, 100.0 * float(np.mean(ratios < limit)) if ratios.size else np.nan, ratios.size)


def _ratio(estimate: Depth, truth: Depth) -> NDArray[np.float64]:
    """The larger of z / z_true and z_true / z; NaN where one is unknown."""
    quotient = estimate.astype(np.float64) / truth
    return np.maximum(quotient, 1.0 / quotient)
