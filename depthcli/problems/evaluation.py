"""Compare estimates with ground truth by the rules of a benchmark: ``evaluate``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from depthcli.core.errors import InputError
from depthcli.core.maps import DepthMap, MatchedMap
from depthcli.core.volumes import Grid
from depthcli.evaluation import protocols
from depthcli.evaluation.protocols import Settings
from depthcli.evaluation.protocols._disparity import DisparityProtocol, scale_warning
from depthcli.evaluation.scores import Score, find_score
from depthcli.io.formats.depth import meters
from depthcli.io.formats.files import collected_warnings
from depthcli.io.formats.images import png_bytes
from depthcli.io.rgbd_frames import RgbdTruth
from depthcli.io.scenes import RgbdScene, Scene, StereoScene, VolumePairScene
from depthcli.io.stereo_pairs import StereoTruth
from depthcli.io.volume_pairs import RegistrationTruth
from depthcli.problems.inputs import as_map, as_volume

_TRUTH = Path("truth")  # file name of a ground truth in memory, for messages


@dataclass(frozen=True, eq=False, repr=False)
class Scores:
    """The scores of an estimate.

    ``error`` is absolute, in the protocol's unit, NaN if estimate or ground truth has no value: (H, W), or (M,) for
    registration errors, at points with known ground truth. ``picture`` is (H, W, 3): blue is correct and orange
    incorrect; grey and purple are the same for occluded pixels; black is no value and white unknown ground truth. It is
    None if the protocol draws no picture.
    """

    protocol: str
    metric: str  # the protocol's ranking metric, with its threshold
    headline: Mapping[str, float]  # region -> value of that metric
    scores: tuple[Score, ...]  # all metrics in all regions
    error: NDArray[np.floating[Any]]
    picture: NDArray[np.uint8] | None
    warnings: tuple[str, ...]  # one line about each doubtful property of the estimate

    def value(self, metric: str, region: str, threshold: float | None = None) -> float:
        """Return the score of a metric, such as ``bad``, in a region, such as ``all``.

        If not exactly one score matches, raise InputError with the possible names.
        """
        try:
            return find_score(self.scores, metric, region, threshold).value
        except KeyError:
            known = ", ".join(dict.fromkeys(score.metric.heading for score in self.scores))
            regions = ", ".join(dict.fromkeys(score.region for score in self.scores))
            score = metric if threshold is None else f"{metric} {threshold:g}"
            text = f"no single score {score!r} of {region!r}; metrics: {known}; regions: {regions}"
            raise InputError(text) from None

    def rows(self) -> list[dict[str, Any]]:
        """Return one row per score for a data frame, with the columns of ``scores.csv`` that identify the score."""
        return [score.row() for score in self.scores]

    def __iter__(self) -> Iterator[Score]:
        return iter(self.scores)

    def __repr__(self) -> str:
        values = ", ".join(f"{region} {value:.4g}" for region, value in self.headline.items())
        return f"Scores({self.protocol}, {self.metric}: {values})"

    def _repr_png_(self) -> bytes | None:
        return None if self.picture is None else png_bytes(self.picture)


def evaluate(
    estimate: ArrayLike | MatchedMap | DepthMap,
    truth: ArrayLike,
    protocol: str = "middlebury-v2",
    mask: ArrayLike | Mapping[str, ArrayLike] | None = None,
    *,
    threshold: float | None = None,
    fb: float | None = None,
    truth_right: ArrayLike | None = None,
    objects: ArrayLike | None = None,
) -> Scores:
    """Return the scores of a map by the rules of a benchmark, with the error of every pixel.

    Raise InputError for an unknown protocol, arrays that differ in size, or ground truth without known values.

    Parameters
    ----------
    estimate : a result, or an array of the ground truth's size: disparities in pixels, depths in meters, or expected
        registration errors in mm; non-finite numbers, and depths that are not positive, are no value
    truth : (H, W) disparities or depths, or registration errors, (Z, Y, X) or (N,) at points; NaN = unknown
    protocol : a name of ``depthcli.evaluation.protocols.names()``, such as ``middlebury-v2`` or ``depth``
    mask : (H, W), True for the pixels to evaluate, the region ``all``; or region -> mask, such as ``nonocc``
    threshold : threshold of the headline, in the protocol's unit; None: the benchmark's
    fb : for depths: focal length x baseline of the sensor, for errors in its pixels
    truth_right : for disparities: the right view's map, from which Middlebury v2 derives ``nonocc`` and ``disc``
    objects : for disparities: (H, W), > 0 on the foreground objects of KITTI 2015

    Examples
    --------
    >>> import depthcli, numpy as np
    >>> truth = np.tile(np.arange(1, 9, dtype=np.float32), (6, 1))
    >>> estimate = truth.copy()
    >>> estimate[0, :4] += 3
    >>> scores = depthcli.evaluate(estimate, truth, "middlebury-v2", mask=truth > 2)
    >>> round(scores.value("bad", "all", 1.0), 2), round(scores.value("avgerr", "all"), 3)
    (5.56, 0.167)
    """
    judge = protocols.load(protocol)(Settings(threshold=threshold))
    if isinstance(estimate, MatchedMap | DepthMap):
        estimate = estimate.values
    scene: Scene
    stored: Any
    warnings: list[str] = []
    if issubclass(judge.kind, VolumePairScene):
        scene = VolumePairScene(name="truth", folder=_TRUTH, fixed=_TRUTH)
        stored, values = _points(estimate, truth, mask)
    elif issubclass(judge.kind, StereoScene):
        scene = StereoScene(name="truth", folder=_TRUTH, left=_TRUTH, disparity_left=_TRUTH)
        stored, values = _disparities(estimate, truth, mask, truth_right, objects)
    else:
        scene = RgbdScene(name="truth", folder=_TRUTH, color=_TRUTH, depth=_TRUTH)
        with collected_warnings() as warnings:
            stored, values = _depths(estimate, truth, mask, fb)
    judge.read_truth = lambda _: stored
    prepared = judge.truth(scene)
    try:
        error = judge.error(values, prepared)
    except ValueError as problem:
        raise InputError(f"estimate: {problem}") from None
    if isinstance(judge, DisparityProtocol):
        warning = scale_warning(judge.resized(values, prepared), prepared.values)
        warnings += [] if warning is None else [warning]
    return Scores(
        judge.name,
        judge.headline.heading,
        protocols.headlines(judge, values, prepared),
        tuple(judge.scores(values, prepared)),
        error,
        protocols.picture(judge, values, prepared),
        tuple(warnings),
    )


def _points(
    estimate: Any, truth: ArrayLike, mask: ArrayLike | Mapping[str, ArrayLike] | None
) -> tuple[RegistrationTruth, NDArray[np.float32]]:
    """Return the true registration errors, and the expected errors at the same points."""
    given, true = np.asanyarray(estimate), np.asanyarray(truth)
    if given.shape != true.shape or given.size == 0:
        raise InputError(f"estimate: shape {given.shape}, but the truth has {true.shape}")
    if isinstance(mask, Mapping):
        raise InputError("mask: registration errors have one region; expected an array")
    expected, error = (as_volume(np.atleast_2d(each), n) for each, n in ((given, "estimate"), (true, "truth")))
    if mask is not None:
        error = np.where(np.asarray(mask).reshape(error.shape) > 0, error, np.float32(np.nan))
    depth, height, width = error.shape
    grid = Grid((width, height, depth), (1.0, 1.0, 1.0))
    inside = np.isfinite(error)
    stored = RegistrationTruth(grid, np.zeros((0, 3)), error)
    if true.ndim == 1 and inside.any():
        stored = RegistrationTruth(grid, np.zeros((int(inside.sum()), 3)), error[inside])
    return stored, expected[inside]


def _disparities(
    estimate: Any,
    truth: ArrayLike,
    mask: ArrayLike | Mapping[str, ArrayLike] | None,
    truth_right: ArrayLike | None,
    objects: ArrayLike | None,
) -> tuple[StereoTruth, NDArray[np.float32]]:
    """Return the true disparities in the mask, and the estimated ones."""
    both = as_map(truth, "truth"), as_map(estimate, "estimate")
    known, values = (np.where(np.isfinite(each), each, np.float32(np.nan)) for each in both)
    shape = known.shape[0], known.shape[1]
    masks = _masks(mask, shape)
    known = np.where(masks.get("all", np.True_), known, np.float32(np.nan))
    right = None if truth_right is None else as_map(truth_right, "truth_right", shape)
    front = None if objects is None else as_map(objects, "objects", shape) > 0
    noc = np.where(masks["noc"], known, np.float32(np.nan)) if "noc" in masks else None
    return StereoTruth(known, right, noc, front, masks), values


def _depths(
    estimate: Any, truth: ArrayLike, mask: ArrayLike | Mapping[str, ArrayLike] | None, fb: float | None
) -> tuple[RgbdTruth, NDArray[np.float32]]:
    """Return the true depths in the mask, and the estimated ones. Raise InputError if their sizes differ."""
    both = as_map(truth, "truth"), as_map(estimate, "estimate")
    known, values = (meters(each, 1.0, name) for each, name in zip(both, ("truth", "estimate"), strict=True))
    shape = known.shape[0], known.shape[1]
    if values.shape != shape:
        sizes = f"{values.shape[1]} x {values.shape[0]}, but the truth is {shape[1]} x {shape[0]}"
        raise InputError(f"estimate: {sizes}")
    masks = _masks(mask, shape)
    return RgbdTruth(np.where(masks.get("all", np.True_), known, np.float32(np.nan)), masks, fb), values


def _masks(mask: ArrayLike | Mapping[str, ArrayLike] | None, shape: tuple[int, int]) -> dict[str, NDArray[np.bool_]]:
    """Return region -> (H, W) bool; a single mask is the region ``all``."""
    named = mask if isinstance(mask, Mapping) else {} if mask is None else {"all": mask}
    return {name: as_map(each, f"mask {name}", shape) > 0 for name, each in named.items()}
