"""Registration confidence: how well the expected error agrees with the true one, and orders points by it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.resampling import trilinear
from depthcli.core.errors import InputError
from depthcli.data.formats.volumes import read_volume
from depthcli.data.scenes import Scene
from depthcli.data.scenes.volume_pair import RegistrationTruth, VolumePairScene
from depthcli.evaluation.curves import sparsification
from depthcli.evaluation.map_files import MapFiles
from depthcli.evaluation.presentation import Presentation
from depthcli.evaluation.protocols import Protocol
from depthcli.evaluation.render import Number, Table
from depthcli.evaluation.results import Curve, Result
from depthcli.evaluation.scores import Measure, Score, percent
from depthcli.evaluation.statistics import correlation, ranks, roc_area

Errors = NDArray[np.float32]

LIMITS_MM = (3.0, 6.0)
"""A point is correct below the first, poor below the second, and wrong from there on (Sokooti et al. 2019)."""

_MAX_POOLED = 20_000  # voxels that are kept of a dense truth to pool scenes, which bounds the memory
_WORST_SHARE = 0.3  # of TRE30, the robustness of Learn2Reg
_N_BINS = 8  # of the table of expected against true errors
_LANDMARK_RADIUS = 1 / 64  # of its ball in pictures, in lengths of the volume; chosen to be well visible


@dataclass(frozen=True)
class PreparedTruth:
    """True registration errors and the points that they are known at.

    Attributes
    ----------
    error : (N,) float32, mm
    landmarks : (N, 3) float64, (z, y, x) in voxels, or None where the truth is dense
    inside : (Z, Y, X) bool, voxels with known error, or None where the truth is at landmarks
    truth : as stored
    """

    error: Errors
    landmarks: NDArray[np.float64] | None
    inside: NDArray[np.bool_] | None
    truth: RegistrationTruth

    @property
    def region(self) -> str:
        """Name of the one region."""
        return "landmarks" if self.inside is None else "voxels"

    @cached_property
    def balls(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Flat indices of the voxels in small balls around the landmarks, and the landmark of each; for pictures."""
        assert self.landmarks is not None
        shape, spacing = np.array(self.truth.grid.shape), np.array(self.truth.grid.spacing[::-1])
        radius = float(max((shape * spacing).max() * _LANDMARK_RADIUS, spacing.min()))
        reach = [np.arange(-n, n + 1) for n in (radius / spacing).astype(int)]
        ball = np.stack(np.meshgrid(*reach, indexing="ij"), -1).reshape(-1, 3)
        ball = ball[np.linalg.norm(ball * spacing, axis=1) <= radius]
        cells = np.rint(self.landmarks).astype(np.intp)[:, None] + ball
        in_volume = np.all((cells >= 0) & (cells < shape), axis=2)
        owner = np.broadcast_to(np.arange(len(cells))[:, None], in_volume.shape)[in_volume]
        flat = np.ravel_multi_index(tuple(cells[in_volume].T), tuple(shape))
        # Where balls meet, the voxel is the last one's.
        chosen, first = np.unique(flat[::-1], return_index=True)
        return chosen, owner[::-1][first]


class ExpectedErrorFiles(MapFiles):
    """Volumes of expected errors, with one confidence volume beside each."""

    def confidences(self, path: Path) -> dict[str, Path]:
        """Return the volume beside ``expected_error`` that is called ``confidence``, if there is one."""
        file = path.with_name(path.name.replace("expected_error", "confidence", 1))
        return {"confidence": file} if file != path and file.is_file() else {}


class RegistrationPresentation(Presentation):
    """Points shown in the fixed volume, and tables of expected against true errors."""

    def on_grid(self, points: NDArray[Any], truth: PreparedTruth) -> NDArray[Any]:
        """Return a (Z, Y, X) volume, in which a landmark is a small ball."""
        volume = np.full(truth.truth.grid.shape, False if points.dtype == np.bool_ else np.nan, points.dtype)
        if truth.inside is not None:
            volume[truth.inside] = points
        else:
            cells, owner = truth.balls
            volume.ravel()[cells] = points[owner]
        return volume

    def spacing(self, truth: PreparedTruth) -> tuple[float, ...]:
        """Return the size of a voxel along z, y and x, mm."""
        return truth.truth.grid.spacing[::-1]

    def image(self, scene: Scene) -> NDArray[np.uint8] | None:
        """Return (Z, Y, X) grey levels of the fixed volume, between its darkest and brightest half percent."""
        if not isinstance(scene, VolumePairScene):
            return None
        values = read_volume(scene.fixed).values
        some = values.ravel()[:: max(1, values.size // _MAX_POOLED)]
        low, high = np.percentile(some[np.isfinite(some)], (0.5, 99.5)) if np.isfinite(some).any() else (0.0, 1.0)
        grey = (np.nan_to_num(values, nan=low) - low) * (255 / max(high - low, 1e-9))
        return np.clip(grey, 0, 255).astype(np.uint8)

    def tables(self, run: str, kept: Sequence[tuple[str, Errors, Errors]]) -> list[Table]:
        """Return the confusion of the classes, and the expected against the true error in bins."""
        expected, true = (np.concatenate([each[k] for each in kept]) for k in (1, 2))
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
            Table(title, ("true class", *names), tuple(counts)),
            Table(f"{run}: expected against true error, in bins of equal size", header, tuple(bins)),
        ]


class RegistrationProtocol(Protocol[Errors, PreparedTruth]):
    """Agreement of expected and true errors, mm, at landmarks, or at every voxel where the true error is dense.

    TRE, the true errors themselves, say how good the registration is, and are the same for every method; TRE30 is the
    mean of the worst 30 % (Learn2Reg's robustness). Means over several pairs are taken over all of their points
    together.
    """

    kind = VolumePairScene
    files = ExpectedErrorFiles(("{scene}/expected_error", "{scene}"), (".nii.gz", ".nii", ".mha", ".nrrd"))
    presentation = RegistrationPresentation(
        title="Registration confidence: expected against true error",
        unit="mm",
        quantity="registration error",
        note=(
            "Spearman: rank correlation of expected and true errors; AUC: share of the pairs of points, one with a "
            "true error above 3 mm and one below, in the right order; accuracy: of the classes < 3, 3-6, >= 6 mm; "
            "MAE: mean |expected - true|, mm; expected: mean, mm; AUSE, AURG: of the true error's sparsification, mm; "
            "TRE: mean true error, mm; TRE30: mean of the worst 30 %; means of several pairs: over all their points"
        ),
        opacity=0.65,
        verdicts=("true error to 3 mm", "true error above 3 mm"),
        mean_heading="pooled",
    )
    region_order = ("landmarks", "voxels")
    headline = Measure("Spearman", "", worst=-1.0, larger_is_better=True)

    def truth(self, scene: Scene) -> PreparedTruth:
        """Return the true errors at landmarks or voxels."""
        stored = scene.truth()
        if not isinstance(stored, RegistrationTruth):
            raise InputError(f"{scene.folder}: {scene.name} has no registration errors, which {self.name} scores")
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
        """Return (N,) confidences at the points of the truth."""
        return _at_points(path, truth)

    def regions(self, truth: PreparedTruth) -> dict[str, NDArray[np.bool_]]:
        """Return the one region, of all points."""
        return {truth.region: np.ones(truth.error.shape, np.bool_)}

    def error(self, estimate: Errors, truth: PreparedTruth) -> NDArray[np.floating[Any]]:
        """Return (N,) |expected - true|, mm."""
        error: NDArray[np.floating[Any]] = np.abs(estimate - truth.error)
        return error

    def wrong(self, estimate: Errors, truth: PreparedTruth) -> NDArray[np.bool_]:
        """Return True for points whose true error is above 3 mm."""
        wrong: NDArray[np.bool_] = truth.error > LIMITS_MM[0]
        return wrong

    def values(self, estimate: Errors, truth: PreparedTruth) -> Errors:
        """Return (N,) expected errors, mm."""
        return estimate

    def true_values(self, truth: PreparedTruth) -> Errors:
        """Return (N,) true errors, mm."""
        return truth.error

    def points(self, estimate: Errors, truth: PreparedTruth) -> list[dict[str, float]]:
        """Return place, expected and true error of every landmark, mm; empty where the true error is dense."""
        rows = zip(*truth.truth.points.T, estimate, truth.error, strict=True) if truth.inside is None else ()
        names = ("x", "y", "z", "expected_error", "true_error")
        return [{name: round(float(v), 4) for name, v in zip(names, row, strict=True)} for row in rows]

    def size(self, truth: PreparedTruth) -> int:
        """Return the number of voxels of the fixed volume."""
        return math.prod(truth.truth.grid.shape)

    def scores(self, estimate: Errors, truth: PreparedTruth) -> list[Score]:
        """Compute every measure over all points."""
        return _scores(truth.region, estimate, truth.error)

    def curves(self, estimate: Errors, truth: PreparedTruth, confidences: Mapping[str, NDArray[Any]]) -> list[Curve]:
        """Compute the sparsification curves of the true error by every confidence."""
        kinds = {"error": truth.error, "bad": self.wrong(estimate, truth)}
        return [
            Curve(truth.region, name, of, sparsification(values, error))
            for name, values in confidences.items()
            for of, error in kinds.items()
        ]

    def keep(self, estimate: Errors, truth: PreparedTruth) -> tuple[str, Errors, Errors]:
        """Return region, expected and true errors, of evenly spread voxels where there are very many."""
        step = max(1, len(estimate) // _MAX_POOLED)
        return truth.region, estimate[::step], truth.error[::step]

    def mean(self, results: Sequence[Result]) -> list[Score]:
        """Compute every measure over all points of the scenes; where a scene lacks a map, the mean of the scores."""
        if any(result.pooled is None for result in results) or not results:
            return super().mean(results)
        made = []
        for region in dict.fromkeys(result.pooled[0] for result in results):
            chosen = [result.pooled for result in results if result.pooled[0] == region]
            made += _scores(region, *(np.concatenate([kept[k] for kept in chosen]) for k in (1, 2)))
        return made


def error_classes(error: NDArray[np.floating[Any]]) -> NDArray[np.int64]:
    """Return 0 for errors below 3 mm, 1 below 6 mm, and 2 from there on."""
    classes: NDArray[np.int64] = np.digitize(error, LIMITS_MM)
    return classes


def _at_points(path: Path, truth: PreparedTruth) -> Errors:
    volume = read_volume(path)
    if not volume.grid.same_as(truth.truth.grid):
        raise InputError(f"{path}: another grid than the fixed volume's")
    if truth.inside is not None:
        return volume.values[truth.inside]
    assert truth.landmarks is not None
    return trilinear(volume.values, truth.landmarks)


def _scores(region: str, expected: Errors, true: Errors) -> list[Score]:
    known = np.isfinite(expected)
    n_known = int(known.sum())
    e, t = expected[known].astype(np.float64), true[known].astype(np.float64)
    ordered = np.sort(true.astype(np.float64))
    worst = ordered[-max(1, round(_WORST_SHARE * len(true))) :]
    line = sparsification(-e, t) if n_known else None
    accuracy = 100 * float(np.mean(error_classes(e) == error_classes(t))) if n_known else np.nan
    values = (
        (RegistrationProtocol.headline, correlation(ranks(e), ranks(t))),
        (Measure("Pearson", "", worst=-1.0, larger_is_better=True), correlation(e, t)),
        (Measure("AUC", "", LIMITS_MM[0], worst=0.0, larger_is_better=True), roc_area(e, t > LIMITS_MM[0])),
        (Measure("accuracy", "%", worst=0.0, larger_is_better=True), accuracy),
        (Measure("MAE", "mm"), float(np.abs(e - t).mean()) if n_known else np.nan),
        (Measure("expected", "mm"), float(e.mean()) if n_known else np.nan),
        (Measure("AUSE", "mm"), np.nan if line is None else line.ause),
        (Measure("AURG", "mm", larger_is_better=True), np.nan if line is None else line.aurg),
        (Measure("TRE", "mm"), float(ordered.mean())),
        (Measure("TRE std", "mm"), float(ordered.std())),
        (Measure("TRE30", "mm"), float(worst.mean())),
    )
    return [Score(measure, region, value, n_known, percent(n_known, len(true))) for measure, value in values]
