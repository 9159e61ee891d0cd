"""Registration confidence: agreement of expected and true error, and the order of points by the expected error."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.body import body_of_volume, grey_levels
from depthcli.algorithms.resampling import trilinear
from depthcli.core.errors import InputError
from depthcli.core.volumes import ENDS, PLANES, Grid
from depthcli.evaluation.curves import ConfidenceCurve, sparsification
from depthcli.evaluation.map_files import MapFiles
from depthcli.evaluation.protocols import Presentation, Protocol, ShownMap, companions
from depthcli.evaluation.scores import MapResult, Metric, Score, percent
from depthcli.evaluation.statistics import correlation, ranks, roc_area
from depthcli.io.formats.volumes import read_volume
from depthcli.io.scenes import Scene, VolumePairScene
from depthcli.io.volume_pairs import RegistrationTruth, true_errors
from depthcli.show.table import Number, Table
from depthcli.show.view import SliceAxis

Errors = NDArray[np.float32]

LIMITS_MM = (3.0, 6.0)
"""A point is correct below the first limit, poor below the second, and incorrect above it (Sokooti et al. 2019)."""

HEADLINE = Metric("Spearman", "", worst=-1.0, larger_is_better=True)
"""Rank correlation of expected and true errors."""

_CAUTION = "expected errors and bounds are estimates checked on other patients, no guarantee; this is no medical device"
_WORST_SHARE = 0.3  # of TRE30, the robustness of Learn2Reg
_MAX_POOLED = 8_000_000  # points of several pairs; of more, which take minutes, so many are drawn
_DRAWING_SEED = 0  # of the points that are drawn, any number: the same for all runs
_N_BINS = 8  # of the table of expected against true errors
_LANDMARK_RADIUS = 1 / 64  # of its ball in pictures, in lengths of the volume; chosen to be well visible


@dataclass(frozen=True)
class PreparedTruth:
    """True registration errors and the points at which they are known."""

    error: Errors  # (N,) float32, mm
    landmarks: NDArray[np.float64] | None  # (N, 3), (z, y, x) in voxels; None where the truth is dense
    inside: NDArray[np.bool_] | None  # (Z, Y, X), voxels with known error; None where the truth is at landmarks
    stored: RegistrationTruth
    looks_like: str = ""

    @property
    def region(self) -> str:
        """Name of the only region."""
        return "landmarks" if self.inside is None else "voxels"

    @property
    def regions(self) -> dict[str, NDArray[np.bool_]]:
        """The one region, of all points."""
        return {self.region: np.ones(self.error.shape, np.bool_)}

    @property
    def values(self) -> Errors:
        """(N,) true errors, mm."""
        return self.error

    @property
    def size(self) -> int:
        """Number of voxels of the fixed volume."""
        return math.prod(self.stored.grid.shape)


class ExpectedErrorFiles(MapFiles):
    """Volumes of expected errors, with one confidence volume each."""

    def confidences(self, path: Path) -> dict[str, Path]:
        """Return the volume ``confidence`` in the folder of ``expected_error``."""
        file = self.companion(path, "confidence")
        return {} if file is None else {"confidence": file}

    def companion(self, path: Path, name: str) -> Path | None:
        """Return the volume ``name``, such as ``bound``, in the folder of ``expected_error``, or None."""
        file = path.with_name(path.name.replace("expected_error", name, 1))
        return file if file != path and file.is_file() else None


def _on_grid(points: NDArray[Any], truth: PreparedTruth) -> NDArray[Any]:
    """Return a volume to show, in which a landmark is a small ball."""
    grid = truth.stored.grid
    volume = np.full(grid.shape, False if points.dtype == np.bool_ else np.nan, points.dtype)
    if truth.inside is not None:
        volume[truth.inside] = points
        return grid.turned(volume)
    assert truth.landmarks is not None
    shape, spacing = np.array(grid.shape), np.array(grid.spacing[::-1])
    radius = float(max((shape * spacing).max() * _LANDMARK_RADIUS, spacing.min()))
    reach = [np.arange(-n, n + 1) for n in (radius / spacing).astype(int)]
    ball = np.stack(np.meshgrid(*reach, indexing="ij"), -1).reshape(-1, 3)
    ball = ball[np.linalg.norm(ball * spacing, axis=1) <= radius]
    for place, value in zip(np.rint(truth.landmarks).astype(np.intp), points, strict=True):
        cells = place + ball
        volume[tuple(cells[np.all((cells >= 0) & (cells < shape), axis=1)].T)] = value
    return grid.turned(volume)


def _turned(file: Path) -> NDArray[Any]:
    volume = read_volume(file, infinite=True)
    return volume.grid.turned(volume.values)


def _shown_map(path: Path, scene: Scene, files: MapFiles) -> ShownMap:
    """Return the expected error within the mask or the body, mm, in the orientation of radiological pictures."""
    assert isinstance(scene, VolumePairScene)
    volume = read_volume(path)
    grid = volume.grid
    if scene.mask is None:
        inside = body_of_volume(_turned(scene.fixed))
    else:
        inside = _turned(scene.mask) > 0
    values = np.where(inside, grid.turned(volume.values), np.float32(np.nan))
    known = values[np.isfinite(values)]
    mean, high = (float(known.mean()), float(np.quantile(known, 0.95))) if known.size else (math.nan, math.nan)
    note = (
        f"{_CAUTION}; in the body: mean over the mask, or over tissue and all that it encloses, and its 95 % quantile"
    )
    figures = {"expected error in the body, mm": mean, "95 % quantile, mm": high}
    return ShownMap(values, axes=_axes(grid), figures=figures, note=note, **companions(path, files, read=_turned))


def _tables(run: str, kept: Sequence[tuple[Errors, Errors]]) -> list[Table]:
    """Return the confusion matrix of the classes, and the expected error in bins of the true error."""
    expected, true = map(np.concatenate, zip(*kept, strict=True))
    known = np.isfinite(expected)
    expected, true = expected[known], true[known]
    names, e, t = ("< 3 mm", "3-6 mm", ">= 6 mm"), error_classes(expected), error_classes(true)
    counts = [(name, *(str(int(np.sum((t == k) & (e == j)))) for j in range(3))) for k, name in enumerate(names)]
    bins = [
        (Number(float(expected[part].mean())), Number(float(true[part].mean())), str(len(part)))
        for part in np.array_split(np.argsort(expected, kind="stable"), min(_N_BINS, max(len(expected), 1)))
        if len(part)
    ]
    title = f"{run}: number of points by true class (rows) and expected class (columns)"
    header = ("mean expected error, mm", "mean true error, mm", "points")
    return [
        Table.of_cells(title, ("true class", *names), tuple(counts)),
        Table.of_cells(f"{run}: expected against true error, in bins of equal size", header, tuple(bins)),
    ]


def error_classes(error: NDArray[np.floating[Any]]) -> NDArray[np.intp]:
    """Return 0 for errors below 3 mm, 1 below 6 mm, and 2 from there on."""
    return np.searchsorted(LIMITS_MM, error, side="right")


def point_scores(region: str, expected: Errors, true: Errors) -> list[Score]:
    """Compute every metric over N > 0 points; expected errors that are not finite are unknown."""
    known = np.isfinite(expected)
    n_known = int(known.sum())
    e, t = expected[known].astype(np.float64), true[known].astype(np.float64)
    ordered = np.sort(true.astype(np.float64))
    worst = ordered[-max(1, round(_WORST_SHARE * len(true))) :]
    line = sparsification(-e, t) if n_known else None
    accuracy = 100 * float(np.mean(error_classes(e) == error_classes(t))) if n_known else np.nan
    values = (
        (HEADLINE, correlation(ranks(e), ranks(t))),
        (Metric("Pearson", "", worst=-1.0, larger_is_better=True), correlation(e, t)),
        (Metric("AUC", "", LIMITS_MM[0], worst=0.0, larger_is_better=True), roc_area(e, t > LIMITS_MM[0])),
        (Metric("accuracy", "%", worst=0.0, larger_is_better=True), accuracy),
        (Metric("MAE", "mm"), float(np.abs(e - t).mean()) if n_known else np.nan),
        (Metric("expected", "mm"), float(e.mean()) if n_known else np.nan),
        (Metric("AUSE", "mm"), np.nan if line is None else line.ause),
        (Metric("AURG", "mm", larger_is_better=True), np.nan if line is None else line.aurg),
        (Metric("TRE", "mm"), float(ordered.mean())),
        (Metric("TRE std", "mm"), float(ordered.std())),
        (Metric("TRE30", "mm"), float(worst.mean())),
    )
    density, n = percent(n_known, len(true)), len(true)
    return [Score(metric, region, value, n_known, density, region_pixels=n) for metric, value in values]


class RegistrationProtocol(Protocol[Errors, PreparedTruth]):
    """Agreement of expected and true errors, mm, at landmarks, or at every voxel if the true error is dense.

    TRE, the true error, measures the registration and is the same for every method; TRE30 is the
    mean of the worst 30 % (Learn2Reg's robustness). Means over several pairs are taken over all of their points
    together.
    """

    kind = VolumePairScene
    read_truth = staticmethod(true_errors)
    files = ExpectedErrorFiles(("{scene}/expected_error", "{scene}"), (".nii.gz", ".nii", ".mha", ".nrrd"))
    presentation = Presentation(
        title="Registration confidence: expected against true error",
        unit="mm",
        quantity="expected error",
        note=(
            "Spearman: rank correlation of expected and true errors; AUC: share of the pairs of points, one with a "
            "true error above 3 mm and one below, in the right order; accuracy: of the classes < 3, 3-6, >= 6 mm; "
            "MAE: mean |expected - true|, mm; expected: mean, mm; AUSE, AURG: of the true error's sparsification, mm; "
            "TRE: mean true error, mm; TRE30: mean of the worst 30 %; pooled: over the points of all pairs; "
            f"{_CAUTION}"
        ),
        opacity=0.65,
        verdicts=("true error to 3 mm", "true error above 3 mm"),
        mean_heading="pooled",
        scale=(0.0, 10.0),
        show=_shown_map,
        image=lambda scene: grey_levels(_turned(scene.fixed)) if isinstance(scene, VolumePairScene) else None,
        on_grid=_on_grid,
        axes=lambda truth: _axes(truth.stored.grid),
        at_points=lambda truth: truth.inside is None,
        tables=_tables,
    )
    region_order = ("landmarks", "voxels")
    within = LIMITS_MM[0]
    headline = HEADLINE

    def truth(self, scene: Scene) -> PreparedTruth:
        """Return the true errors at landmarks or voxels."""
        scene.check()
        if not isinstance(scene, VolumePairScene):
            raise InputError(f"{scene.folder}: {scene.name} has no registration errors, which {self.name} scores")
        stored: RegistrationTruth = self.read_truth(scene)
        if stored.error.ndim == 1:
            return PreparedTruth(stored.error, stored.grid.to_index(stored.points), None, stored)
        inside = np.isfinite(stored.error)
        if not inside.any():
            raise InputError(f"{scene.folder}: the true error of {scene.name} is known nowhere")
        return PreparedTruth(stored.error[inside], None, inside, stored)

    def read(self, path: Path, scene: Scene, truth: PreparedTruth) -> Errors:
        """Return (N,) expected errors at the points of the truth."""
        return _at_points(path, truth)

    def read_confidence(self, path: Path, truth: PreparedTruth) -> NDArray[Any]:
        return _at_points(path, truth)

    def error(self, estimate: Errors, truth: PreparedTruth) -> NDArray[np.floating[Any]]:
        """Return (N,) |expected - true|, mm."""
        return abs(estimate - truth.error)

    def bounded_error(self, estimate: Errors, truth: PreparedTruth) -> NDArray[np.floating[Any]]:
        """Return (N,) true errors, mm, which a bound limits."""
        return np.where(np.isfinite(estimate), truth.error, np.float32(np.nan))

    def wrong(self, estimate: Errors, truth: PreparedTruth) -> NDArray[np.bool_]:
        """Return True for points whose true error is above 3 mm."""
        return truth.error > LIMITS_MM[0]

    def values(self, estimate: Errors, truth: PreparedTruth) -> Errors:
        """Return (N,) expected errors, mm."""
        return estimate

    def points(self, estimate: Errors, truth: PreparedTruth) -> tuple[list[dict[str, float]], tuple[Errors, Errors]]:
        """Return place, expected and true error of every landmark, mm; and expected and true errors of all points.

        There is no table if the true error is dense.
        """
        rows = zip(*truth.stored.points.T, estimate, truth.error, strict=True) if truth.inside is None else ()
        names = ("x", "y", "z", "expected_error", "true_error")
        table = [{name: round(float(v), 4) for name, v in zip(names, row, strict=True)} for row in rows]
        return table, (estimate, truth.error)

    def scores(self, estimate: Errors, truth: PreparedTruth) -> list[Score]:
        return point_scores(truth.region, estimate, truth.error)

    def curves(
        self, estimate: Errors, truth: PreparedTruth, confidences: Mapping[str, NDArray[Any]]
    ) -> list[ConfidenceCurve]:
        """Compute the sparsification curves of the true error by every confidence."""
        kinds = {"error": truth.error, "bad": self.wrong(estimate, truth)}
        return [
            ConfidenceCurve(truth.region, name, of, sparsification(values, error))
            for name, values in confidences.items()
            for of, error in kinds.items()
        ]

    def mean(self, results: Sequence[MapResult]) -> list[Score]:
        """Compute every metric over all points of the scenes; points of a scene without any value count as the worst.

        If there are more than ``_MAX_POOLED`` points, the same share of every scene is drawn, independently by scene.
        """
        scored = [result for result in results if result.scores]
        regions = dict.fromkeys(result.scores[0].region for result in scored)
        means: list[Score] = []
        for region in regions:
            alike = [r for r in scored if r.scores[0].region == region]
            answered = [r for r in alike if r.pooling_data is not None and np.isfinite(r.pooling_data[0]).any()]
            if len(alike) == 1:
                means += alike[0].scores
            elif not answered:
                means += super().mean(alike)
            else:
                n_points, n_answered = (sum(r.scores[0].region_pixels for r in group) for group in (alike, answered))
                drawn = [_drawn(r.pooling_data, _MAX_POOLED / n_points) for r in answered]
                scores = point_scores(region, *map(np.concatenate, zip(*drawn, strict=True)))
                means += [_with_missing(score, 1 - n_answered / n_points, n_points) for score in scores]
        return means


def _axes(grid: Grid) -> tuple[SliceAxis, ...]:
    """Return the axes of a turned volume."""
    return tuple(SliceAxis(PLANES[k], ENDS[k], *grid.slice_positions(k)) for k in range(3))


def _drawn(points: tuple[Errors, Errors], share: float) -> tuple[Errors, Errors]:
    """Return expected and true errors of a share of the points; all if it is 1 or more."""
    if share >= 1:
        return points
    expected, true = points
    chosen = np.random.default_rng(_DRAWING_SEED).choice(len(true), max(1, round(share * len(true))), replace=False)
    return expected[chosen], true[chosen]


def _with_missing(score: Score, share: float, n_points: int) -> Score:
    """Return the score if a share of the points is in scenes without values; NaN if there is no worst value."""
    if share == 0:
        return replace(score, region_pixels=n_points)
    worst = math.nan if score.metric.worst is None else score.metric.worst
    value, density = share * worst + (1 - share) * score.value, (1 - share) * score.density
    return replace(score, value=value, density=density, region_pixels=n_points)


def _at_points(path: Path, truth: PreparedTruth) -> Errors:
    volume = read_volume(path, infinite=True)
    if not volume.grid.same_as(truth.stored.grid):
        raise InputError(
            f"{path}: another grid than the fixed volume's ({volume.grid.describe_difference(truth.stored.grid)})"
        )
    if truth.inside is not None:
        return volume.values[truth.inside]
    assert truth.landmarks is not None
    endless = np.isposinf(volume.values)  # open bounds: so is what is interpolated between them and others
    values = trilinear(np.where(endless, np.float32(0), volume.values), truth.landmarks)
    return np.where(trilinear(endless.astype(np.float32), truth.landmarks) > 0, np.float32(np.inf), values)
