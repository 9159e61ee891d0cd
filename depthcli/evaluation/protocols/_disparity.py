"""Common part of the stereo protocols: disparity maps and their ground truth, and warnings about incorrect scales."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.core.maps import Status
from depthcli.evaluation.map_files import DisparityFiles, MapFiles
from depthcli.evaluation.protocols import Presentation, Protocol, Settings, ShownMap, companions
from depthcli.evaluation.scores import MISSING_IS_BAD, Metric, Score, Tally, in_order
from depthcli.io.formats.disparity import read_disparity, read_foreign_map, read_status, scale_of
from depthcli.io.formats.files import warn
from depthcli.io.scenes import Scene, StereoScene
from depthcli.io.stereo_pairs import StereoTruth, true_disparity
from depthcli.show.view import STATUS_PALETTE

Disparity = NDArray[np.float32]
Masks = dict[str, NDArray[np.bool_]]

_INCONSISTENT = (
    "left-right inconsistent: share of the pixels that the check of both views rejected, occluded ones among them, "
    "filled or not"
)
_N_DENSE, _MAX_DENSE_PX = 24, 6.0  # number of evenly spaced thresholds of a plot, and the largest
_MAX_KITTI_KNOWN = 0.5  # of a laser scanner's truth, which has about 20 %, with the models of cars more


def _shown_map(path: Path, scene: Scene, files: MapFiles) -> ShownMap:
    """Return a run's map with the shares of inconsistent pixels (by its status) and of pixels without a value."""
    values, file = read_disparity(path), files.companion(path, "status.png")
    figures = {"left-right inconsistent, %": np.nan, "no value, %": 100.0 * float(np.isnan(values).mean())}
    if file is not None:
        rejected = (read_status(file) & int(Status.OCCLUDED | Status.MISMATCH)) != 0
        figures["left-right inconsistent, %"] = 100.0 * float(rejected.mean())
    return ShownMap(values, figures=figures, note=_INCONSISTENT, **companions(path, files))


PRESENTATION = Presentation(
    unit="px", quantity="disparity", threshold_axis="threshold, px", error_pictures=True, visible_region="nonocc",
    palette=STATUS_PALETTE, show=_shown_map,
)  # fmt: skip
"""Common to all stereo protocols, which add title and note."""


@dataclass(frozen=True)
class DisparityTruth:
    """Ground truth of the left view, prepared for comparisons."""

    values: Disparity  # (H, W) float32, pixels, NaN = unknown
    masks: Mapping[str, NDArray[np.bool_]]  # name -> (H, W), True = evaluate
    noc: Disparity | None = None  # (H, W) float32, values of the visible pixels if they have their own (KITTI)
    scale: float | None = None  # codes per pixel of the truth's files
    max_disparity: int | None = None  # values of an estimate are clipped (Middlebury v3)
    round_disparity: bool = False  # and rounded
    factor: int = 1  # size of the benchmark's full image / size of this one (Middlebury v3)
    looks_like: str = ""  # other protocols that such a truth is usually scored by

    def reference(self, region: str) -> Disparity:
        """Return the true values for a region; regions of ``noc`` can have values of their own."""
        return self.noc if self.noc is not None and region.startswith("noc") else self.values

    @cached_property
    def regions(self) -> Masks:
        """The pixels of the masks with known ground truth."""
        return {name: mask & ~np.isnan(self.reference(name)) for name, mask in self.masks.items()}

    @property
    def size(self) -> int:
        return self.values.size


class DisparityProtocol(Protocol[Disparity, DisparityTruth]):
    """A protocol for (H, W) float32 disparity maps in pixels, NaN = no value.

    A derived protocol adds ``presentation``, ``thresholds`` of the tables and ``default_threshold`` of the headline,
    in pixels. It may replace ``masks``, which defines the regions, ``scores``, which gets the errors of every region
    from ``tallies``, and ``values``, if maps are changed before the comparison.
    """

    kind = StereoScene
    read_truth = staticmethod(true_disparity)
    files = DisparityFiles()
    curve_regions: ClassVar[tuple[str, ...]] = ("nonocc", "all")
    within = 1.0
    status_groups: ClassVar[Mapping[str, int]] = {
        "occluded": Status.OCCLUDED | Status.OUT_OF_RANGE,
        "filled": Status.MISMATCH | Status.NO_DATA | Status.FILLED,
        "measured": 0,
    }
    takes: ClassVar[tuple[str, ...]] = ("scale", "threshold", "invalid")
    thresholds: ClassVar[tuple[float, ...]]
    default_threshold: ClassVar[float]
    # The headline without its threshold.
    thresholded_metric: ClassVar[Metric] = Metric("bad", "%", convention=MISSING_IS_BAD, worst=100.0)

    def __init__(self, settings: Settings | None = None) -> None:
        super().__init__(settings)
        self.all_thresholds = sorted({*self.thresholds, *filter(None, [self.settings.threshold])})
        self.headline = self.at(self.settings.threshold or self.default_threshold)

    def at(self, threshold: float) -> Metric:
        """Return the headline's metric at another threshold."""
        return replace(self.thresholded_metric, threshold=threshold)

    def masks(self, stored: StereoTruth) -> Masks:
        """Return name -> mask of every region, from the files."""
        return {**stored.masks, "all": stored.masks.get("all", ~np.isnan(stored.disparity))}

    def truth(self, scene: Scene) -> DisparityTruth:
        """Return the ground truth of the left view with its masks."""
        if not isinstance(scene, StereoScene):
            raise InputError(f"{scene.folder}: {scene.name} is no stereo pair, which {self.name} scores")
        stored = self.read_truth(replace(scene, invalid=self.settings.invalid))
        known, (height, width), other = float(np.mean(~np.isnan(stored.disparity))), stored.disparity.shape, ""
        if not known:
            raise InputError(f"{scene.disparity_left}: the ground truth has no known pixel")
        if 370 <= height <= 376 and 1224 <= width <= 1242 and known < _MAX_KITTI_KNOWN:  # KITTI's rectified frames
            share = f"{width} x {height}, truth at {100 * known:.0f} % of the pixels"
            other = f"frames of kitti-2015 or kitti-2012 ({share})"
        masks = self.masks(stored)
        ordered = {name: masks[name] for name in in_order(masks, self.region_order)}
        top, rounded = scene.max_disparity, scene.round_disparity
        return DisparityTruth(stored.disparity, ordered, stored.noc, stored.scale, top, rounded, looks_like=other)

    def read(self, path: Path, scene: Scene, truth: DisparityTruth) -> Disparity:
        """Return the map in pixels; 8-bit codes have the truth's scale if the settings have none.

        The setting ``invalid`` means no value. Without it, frequent constants in another program's map mean no value,
        with a warning. A scale that looks incorrect also gives a warning.
        """
        codes = truth.scale if truth.scale is not None and truth.scale < 256 else None
        scale = scale_of(path, self.settings.scale, self.settings.any_scale)
        estimate = read_foreign_map(path, scale, self.settings.invalid, codes, self.kitti_codes)
        try:
            warning = scale_warning(self.resized(estimate, truth), truth.values)
        except ValueError as error:
            raise InputError(f"{path}: {error}") from None
        if warning is not None:
            warn(warning)
        return estimate

    def resized(self, estimate: Disparity, truth: DisparityTruth) -> Disparity:
        """Return the estimate on the truth's grid; ValueError if the size does not fit."""
        if estimate.shape != truth.values.shape:
            raise ValueError(f"the map is {size(estimate)}, the truth {size(truth.values)}")
        return estimate

    def lowest(self, truth: DisparityTruth) -> float:
        """Return the smallest number that counts as a value: 0, or less if the ground truth is negative, too."""
        return -np.inf if np.nanmin(truth.values, initial=np.float32(0)) < 0 else 0.0

    def values(self, estimate: Disparity, truth: DisparityTruth) -> Disparity:
        """Return the values that are compared: the estimate without values below :meth:`lowest`."""
        fitted = self.resized(estimate, truth)
        with np.errstate(invalid="ignore"):
            return np.where(fitted < self.lowest(truth), np.float32(np.nan), fitted)

    def error(self, estimate: Disparity, truth: DisparityTruth) -> Disparity:
        """Return (H, W) float32, pixels: single precision, as in the benchmarks' programs."""
        return difference(self.values(estimate, truth), truth.values)

    def tallies(self, estimate: Disparity, truth: DisparityTruth) -> list[Tally]:
        """Return the errors of every region."""
        error = self.error(estimate, truth)
        return [Tally(name, error[region]) for name, region in truth.regions.items()]

    def scores(self, estimate: Disparity, truth: DisparityTruth) -> list[Score]:
        """Compute the share of bad pixels at all thresholds, missing ones included, ``avgerr`` and ``rms``."""
        scores = []
        for tally in self.tallies(estimate, truth):
            scores += [tally.rate(self.at(t), ~(tally.error <= np.float32(t))) for t in self.all_thresholds]
            scores += tally.means()
        return scores

    def threshold_curve(self, estimate: Disparity, truth: DisparityTruth) -> list[Score]:
        """Compute the headline's metric at its thresholds and at others up to 6 px, or twice the user's."""
        dense, main = copy(self), next(iter(truth.regions))
        top = max(_MAX_DENSE_PX, 2 * (self.settings.threshold or 0.0))
        dense.all_thresholds = sorted({*self.all_thresholds, *(top * k / _N_DENSE for k in range(1, _N_DENSE + 1))})
        scores = dense.scores(estimate, replace(truth, masks={main: truth.masks[main]}))
        return [s for s in scores if s.metric.threshold is not None and s.metric == self.at(s.metric.threshold)]


def difference(estimate: Disparity, truth: Disparity) -> Disparity:
    """Return the absolute difference in single precision; NaN if one of the two has no value."""
    with np.errstate(over="ignore", invalid="ignore"):
        return abs(estimate - truth)


def size(array: NDArray[Any]) -> str:
    """Return the size of an (H, W) array as text: width x height."""
    return f"{array.shape[1]} x {array.shape[0]}"


_HINTS = {
    256.0: "KITTI codes read as pixels?", 16.0: "OpenCV's fixed-point disparities, or Middlebury codes?",
    64.0: "fixed-point codes read as pixels?", 2.0: "a map of twice the size?", 0.5: "computed at half size?",
    0.25: "computed at quarter size?",
}  # fmt: skip
_SCALES = (2.0, 3.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0, 256.0)  # factors of codes and image sizes in use


def scale_warning(estimate: Disparity, truth: Disparity) -> str | None:
    """Return a warning if the estimate looks like the ground truth in another unit, a frequent mistake.

    The condition is that the ratio of estimate to truth is within 8 % of one factor at half of the pixels: a power of
    two, 3, a reciprocal of these, or -1 for a swapped sign. None: no warning.
    """
    with np.errstate(invalid="ignore"):
        both = ~np.isnan(estimate) & (truth > 0.5)
    if np.count_nonzero(both) < 50:
        return None
    ratio = estimate[both].astype(np.float64) / truth[both]
    middle = float(np.median(ratio))
    for factor in (-1.0, *_SCALES, *(1 / f for f in _SCALES)):
        if abs(middle / factor - 1) < 0.08 and np.mean(np.abs(ratio / factor - 1) < 0.08) >= 0.5:
            if factor == -1:
                return "the values are about -1 times the truth: the sign is swapped"
            name = f"{factor:g}" if factor >= 1 else f"1/{1 / factor:g}"
            hint = f"a wrong scale? {_HINTS.get(factor, '')}".rstrip()
            return f"the values are about {name} times the truth (median ratio {middle:.3g}): {hint}"
    return None
