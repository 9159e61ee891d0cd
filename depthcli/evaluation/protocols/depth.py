"""Depth maps of one view: errors in millimeters and relative to the depth, by region."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.cameras.triangulation import disparity_of_depth
from depthcli.core.errors import InputError
from depthcli.core.maps import DepthStatus
from depthcli.evaluation.map_files import MapFiles
from depthcli.evaluation.protocols import Presentation, Protocol, ShownMap, companions
from depthcli.evaluation.scores import ESTIMATED_ONLY, Metric, Score, Tally, in_order
from depthcli.io.formats.depth import read_depth
from depthcli.io.formats.disparity import read_plane
from depthcli.io.formats.files import collected_warnings, warn
from depthcli.io.rgbd_frames import load_frame, true_depth
from depthcli.io.scenes import RgbdScene, Scene
from depthcli.show.view import DEPTH_STATUS_PALETTE

Depth = NDArray[np.float32]

_RATIOS = (1.05, 1.10, 1.25, 1.25**2, 1.25**3)  # of delta, as in ClearGrasp and the evaluations of NYU
_WRONG_RATIO = 1.05  # ratio from which on a pixel is shown as incorrect: the smallest of delta


@dataclass(frozen=True)
class DepthTruth:
    """True depth, prepared for comparisons."""

    depth: Depth  # (H, W) float32, meters, NaN = unknown
    regions: dict[str, NDArray[np.bool_]]  # name -> (H, W), pixels with known truth
    fb: float | None  # focal length x baseline, pixel meters
    scale: float | None  # codes a meter of the truth's files; None: by their kind
    looks_like: str = ""

    @property
    def values(self) -> NDArray[np.float64]:
        """(H, W) millimeters."""
        return 1000.0 * self.depth.astype(np.float64)

    @property
    def size(self) -> int:
        return self.depth.size


def _shown_map(path: Path, scene: Scene, files: MapFiles) -> ShownMap:
    """Return a run's map and its bound in mm."""
    scale = getattr(scene, "depth_scale", None)
    values = 1000.0 * read_depth(path, scale, scale_floats=False).astype(np.float64)
    figures = {"no value, %": 100.0 * float(np.isnan(values).mean())}
    return ShownMap(values, figures=figures, **companions(path, files, 1000.0))


def _sensor(scene: Scene) -> NDArray[np.float64] | None:
    """Return the sensor's depth in mm, registered to the color image; None if it cannot be read."""
    if not isinstance(scene, RgbdScene):
        return None
    try:
        with collected_warnings():
            return 1000.0 * load_frame(scene).depth.astype(np.float64)
    except InputError:
        return None


class DepthProtocol(Protocol[Depth, DepthTruth]):
    """Mean and root-mean-square errors, relative errors, and shares of pixels within a ratio of the truth.

    The metrics come from the depth completion literature: MAE and RMSE in millimeters, REL the mean of ``|z - z_true|
    / z_true``, and delta, the percentage of pixels with ``max(z / z_true, z_true / z)`` below 1.05, 1.10 and 1.25
    (ClearGrasp's ``eval_depth_completion.py``, TransCG's ``utils/metrics.py``) and below 1.25 squared and cubed (the
    convention of NYU). If the sensor's focal length x baseline is known, ``MAE px`` and ``bad 1 px`` are the same
    errors in pixels of its disparity. All figures are over the estimated pixels; ``coverage`` is their share.
    """

    kind = RgbdScene
    read_truth = staticmethod(true_depth)
    files = MapFiles(("{scene}/depth", "{scene}"), (".pfm", ".npy", ".npz", ".exr", ".png", ".pgm", ".tif", ".tiff"))
    presentation = Presentation(
        title="Depth: mean absolute error, mm; estimated pixels only",
        unit="mm",
        note=(
            "MAE, RMSE: mm; REL: mean of |error| / true depth; delta: % of the estimated pixels within that ratio "
            "of the truth; px: of the sensor's disparity; coverage: % of the pixels with known truth that have a value"
        ),
        error_pictures=True,
        quantity="depth",
        threshold_axis="ratio to the truth",
        palette=DEPTH_STATUS_PALETTE,
        show=_shown_map,
        sensor=_sensor,
    )
    region_order = ("all", "gap", "occluded", "specular", "mismatch", "measured", "object", "transparent")
    map_unit = 1000.0
    within = 0.03
    status_groups: ClassVar[Mapping[str, int]] = {
        "filled": DepthStatus.GAP_FILLED | DepthStatus.FALLBACK | DepthStatus.CARRIED,
        "corrected": DepthStatus.CORRECTED,
        "kept": 0,
    }
    takes = ("scale", "threshold", "invalid", "resize")
    headline = Metric("MAE", "mm", convention=ESTIMATED_ONLY)

    def truth(self, scene: Scene) -> DepthTruth:
        """Return the true depth with its regions, at the size of the settings."""
        scene.check()
        if not isinstance(scene, RgbdScene):
            raise InputError(f"{scene.folder}: {scene.name} has no true depth, which {self.name} scores")
        stored = self.read_truth(replace(scene, invalid=self.settings.invalid))
        depth = self._resized(stored.depth)
        known = np.isfinite(depth)
        if not known.any():
            raise InputError(f"{scene.folder}: the true depth of {scene.name} has no known pixel")
        masks = {name: self._resized(mask.astype(np.uint8)) > 0 for name, mask in stored.masks.items()}
        regions = {"all": known, **{name: mask & known for name, mask in masks.items()}}
        if scene.sparse is not None and scene.sparse_source:
            warn(f"sparse depth from {scene.sparse_source}: methods that use it are judged by what they were given")
        ordered = {name: regions[name] for name in in_order(regions, self.region_order)}
        return DepthTruth(depth, ordered, stored.fb, scene.depth_scale)

    def read(self, path: Path, scene: Scene, truth: DepthTruth) -> Depth:
        """Return the map in meters; integer codes have the scale of the ground truth if the settings have none."""
        scale, floats = self.settings.scale or truth.scale, self.settings.any_scale
        estimate = self._resized(read_depth(path, scale, invalid=self.settings.invalid, scale_floats=floats))
        if estimate.shape != truth.depth.shape:
            have, known = (f"{a.shape[1]} x {a.shape[0]}" for a in (estimate, truth.depth))
            raise InputError(f"{path}: the map is {have}, the truth {known}; evaluate --resize brings both to one size")
        return estimate

    def _resized(self, array: NDArray[Any]) -> NDArray[Any]:
        if self.settings.resize is None:
            return array
        return cv2.resize(array, self.settings.resize, interpolation=cv2.INTER_NEAREST)

    def read_confidence(self, path: Path, truth: DepthTruth) -> NDArray[Any]:
        """Return a map as stored, at the size of the settings. Raise InputError for another size."""
        values = self._resized(read_plane(path))
        if values.shape != truth.depth.shape:
            raise InputError(f"{path}: the size differs from the truth's")
        return values

    def error(self, estimate: Depth, truth: DepthTruth) -> NDArray[np.float64]:
        """Return (H, W) float64, millimeters."""
        return 1000.0 * np.abs(estimate.astype(np.float64) - truth.depth)

    def values(self, estimate: Depth, truth: DepthTruth) -> NDArray[np.floating[Any]]:
        """Return (H, W) float64, millimeters."""
        return 1000.0 * estimate.astype(np.float64)

    def wrong(self, estimate: Depth, truth: DepthTruth) -> NDArray[np.bool_]:
        """Return True for pixels off by 5 % or more, or by more than the settings' threshold in mm."""
        if self.settings.threshold is not None:
            return self.error(estimate, truth) > self.settings.threshold
        return _ratio(estimate, truth.depth) >= _WRONG_RATIO

    def threshold_curve(self, estimate: Depth, truth: DepthTruth) -> list[Score]:
        """Compute delta at ratios up to 1.5."""
        name, region = next(iter(truth.regions.items()))
        tally = Tally(name, self.error(estimate, truth)[region])
        inside = _ratio(estimate, truth.depth)[region][~np.isnan(tally.error)]
        return [_delta(tally, inside, 1 + k / 100) for k in range(1, 51)]

    def scores(self, estimate: Depth, truth: DepthTruth) -> list[Score]:
        error, ratio = self.error(estimate, truth), _ratio(estimate, truth.depth)
        pixels = None
        if truth.fb is not None:
            pixels = np.abs(disparity_of_depth(estimate, truth.fb) - disparity_of_depth(truth.depth, truth.fb))
        scores: list[Score] = []
        for name, region in truth.regions.items():
            tally = Tally(name, error[region])
            known = ~np.isnan(tally.error)
            square = _mean(tally, replace(self.headline, name="RMSE"), tally.valid * tally.valid)
            relative = (error[region] / (1000.0 * truth.depth[region]))[known]
            scores += [
                _mean(tally, self.headline, tally.valid),
                replace(square, value=float(np.sqrt(square.value))),
                _mean(tally, Metric("REL", "", convention=ESTIMATED_ONLY), relative),
                *(_delta(tally, ratio[region][known], limit) for limit in _RATIOS),
            ]
            if pixels is not None:
                off = pixels[region][known]
                scores.append(_mean(tally, Metric("MAE", "px", convention=ESTIMATED_ONLY, label="MAE px"), off))
                scores.append(tally.rate(Metric("bad", "%", 1.0, ESTIMATED_ONLY, label="bad 1 px"), off > 1.0))
            coverage = Metric("coverage", "%", worst=0.0, larger_is_better=True)
            scores.append(tally.number(coverage, tally.density, tally.error.size))
        return scores


def _mean(tally: Tally, metric: Metric, values: NDArray[np.floating[Any]]) -> Score:
    return tally.number(metric, float(values.mean()) if values.size else np.nan, values.size)


def _delta(tally: Tally, ratios: NDArray[np.float64], limit: float) -> Score:
    """Return the percentage of ``ratios`` of the estimated pixels below a limit."""
    metric = Metric("delta", "%", round(limit, 4), ESTIMATED_ONLY, larger_is_better=True, label=f"delta {limit:.4g}")
    return tally.number(metric, 100.0 * float(np.mean(ratios < limit)) if ratios.size else np.nan, ratios.size)


def _ratio(estimate: Depth, truth: Depth) -> NDArray[np.float64]:
    """Return the larger of z / z_true and z_true / z; NaN if one is unknown."""
    quotient = estimate.astype(np.float64) / truth
    return np.maximum(quotient, 1.0 / quotient)
