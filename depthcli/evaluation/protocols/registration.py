"""Registration confidence: how well the expected error orders, and says, the true one."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.data.scenes import Scene
from depthcli.data.scenes.volume_pair import RegistrationTruth, VolumePairScene
from depthcli.evaluation.curves import sparsification
from depthcli.evaluation.protocols import Protocol
from depthcli.evaluation.report import Table, number
from depthcli.evaluation.results import Curve, Result
from depthcli.evaluation.scores import Measure, Score, percent

if TYPE_CHECKING:
    from depthcli.evaluation.results import Section

Errors = NDArray[np.float32]

LIMITS = (3.0, 6.0)
"""Correct below the first, poor below the second, wrong from there on, mm (Sokooti et al. 2019)."""

_KEPT = 20_000  # voxels of a dense truth that the pooled figures are over
_ROBUST = 0.3
_DOT = 1 / 64  # radius of a landmark in pictures, in lengths of the volume


@dataclass(frozen=True)
class PreparedTruth:
    """True errors, and the places (z, y, x in voxels) that they are at.

    Attributes
    ----------
    error : (N,) mm
    places : (N, 3) of landmarks in voxels, or None for voxels, which ``inside`` says
    inside : (Z, Y, X) bool of a dense truth, or None
    truth : as stored
    """

    error: Errors
    places: NDArray[np.float64] | None
    inside: NDArray[np.bool_] | None
    truth: RegistrationTruth

    @cached_property
    def dots(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Voxels (flat indices) within small balls around the landmarks, and whose they are; for pictures."""
        assert self.places is not None
        shape, spacing = np.array(self.truth.grid.shape), np.array(self.truth.grid.spacing[::-1])
        radius = float(max((shape * spacing).max() * _DOT, spacing.min()))
        reach = [np.arange(-n, n + 1) for n in (radius / spacing).astype(int)]
        ball = np.stack(np.meshgrid(*reach, indexing="ij"), -1).reshape(-1, 3)
        ball = ball[np.linalg.norm(ball * spacing, axis=1) <= radius]
        cells = np.rint(self.places).astype(np.intp)[:, None] + ball
        there = np.all((cells >= 0) & (cells < shape), axis=2)
        owner = np.broadcast_to(np.arange(len(cells))[:, None], there.shape)[there]
        flat = np.ravel_multi_index(tuple(cells[there].T), tuple(shape))
        # Where balls meet, the voxel is the last one's.
        chosen, first = np.unique(flat[::-1], return_index=True)
        return chosen, owner[::-1][first]


class RegistrationProtocol(Protocol[Errors, PreparedTruth]):
    """Expected against true error, in mm, at landmarks, or at every voxel where the true error is dense.

    TRE are the true errors themselves: they say how good the registration is, the same for every method. TRE30 is the
    mean of the worst 30 % (Learn2Reg's robustness). Means over several pairs are pooled: taken over all of their points
    together.
    """

    title = "Registration confidence: expected against true error"
    unit = "mm"
    quantity = "registration error"
    note = (
        "Spearman: how well the expected errors order the true ones, 1 = perfectly, 0 = by chance; TRE: true "
        "error, mm; AUC: share of point pairs, one with an error above 3 mm, one below, in the right order; "
        "accuracy: of the classes < 3, 3-6, >= 6 mm; MAE: |expected - true|, mm; AUSE, AURG: mm; several pairs: pooled"
    )
    kind = VolumePairScene
    places = ("{scene}/expected_error", "{scene}")
    suffixes = (".nii.gz", ".nii", ".mha", ".nrrd")
    mask_order = ("landmarks", "voxels")
    opacity = 0.65
    verdicts = ("true error to 3 mm", "true error above 3 mm")
    pooling = "pooled"
    spearman = Measure("Spearman", "", worst=-1.0, larger_is_better=True)

    @property
    def headline(self) -> Measure:
        """Rank correlation of expected and true error."""
        return self.spearman

    def truth(self, scene: Scene) -> PreparedTruth:
        """True errors at landmarks or voxels."""
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
        """Expected errors at the places of the truth."""
        return self._at(path, truth)

    def _at(self, path: Path, truth: PreparedTruth) -> Errors:
        from depthcli.data.formats.volumes import linear, read_volume

        volume = read_volume(path)
        if not volume.grid.same_as(truth.truth.grid):
            raise InputError(f"{path}: another grid than the fixed volume's")
        if truth.inside is not None:
            return volume.values[truth.inside]
        assert truth.places is not None
        return linear(volume.values, truth.places)

    def nothing(self, truth: PreparedTruth) -> Errors:
        """No expectation anywhere."""
        return np.full_like(truth.error, np.nan)

    def regions(self, truth: PreparedTruth) -> dict[str, NDArray[np.bool_]]:
        """The one list of points."""
        return {_mask(truth): np.ones(truth.error.shape, np.bool_)}

    def error(self, estimate: Errors, truth: PreparedTruth) -> NDArray[np.floating[Any]]:
        """(N,) |expected - true|, mm."""
        error: NDArray[np.floating[Any]] = np.abs(estimate - truth.error)
        return error

    def wrong(self, estimate: Errors, truth: PreparedTruth) -> NDArray[np.bool_]:
        """Points whose true error is above 3 mm."""
        wrong: NDArray[np.bool_] = truth.error > LIMITS[0]
        return wrong

    def values(self, estimate: Errors, truth: PreparedTruth) -> Errors:
        """(N,) expected errors, mm."""
        return estimate

    def true_values(self, truth: PreparedTruth) -> Errors:
        """(N,) true errors, mm."""
        return truth.error

    def laid_out(self, points: NDArray[Any], truth: PreparedTruth) -> NDArray[Any] | None:
        """(Z, Y, X); a landmark is a small ball."""
        volume = np.full(truth.truth.grid.shape, False if points.dtype == np.bool_ else np.nan, points.dtype)
        if truth.inside is not None:
            volume[truth.inside] = points
        else:
            cells, owner = truth.dots
            volume.ravel()[cells] = points[owner]
        return volume

    def size(self, truth: PreparedTruth) -> int:
        """All voxels of the fixed volume."""
        return math.prod(truth.truth.grid.shape)

    def spacing(self, truth: PreparedTruth) -> tuple[float, ...]:
        """Of the voxels, mm."""
        return truth.truth.grid.spacing[::-1]

    def image(self, scene: Scene) -> NDArray[np.uint8] | None:
        """(Z, Y, X) grey levels of the fixed volume, between its darkest and brightest half percent."""
        from depthcli.data.formats.volumes import read_volume

        if not isinstance(scene, VolumePairScene):
            return None
        values = read_volume(scene.fixed).values
        some = values.ravel()[:: max(1, values.size // _KEPT)]
        low, high = np.percentile(some[np.isfinite(some)], (0.5, 99.5)) if np.isfinite(some).any() else (0.0, 1.0)
        grey = (np.nan_to_num(values, nan=low) - low) * (255 / max(high - low, 1e-9))
        return np.clip(grey, 0, 255).astype(np.uint8)

    def scores(self, estimate: Errors, truth: PreparedTruth) -> list[Score]:
        """Every measure."""
        return _scores(self.spearman, _mask(truth), estimate, truth.error)

    def confidences(self, path: Path) -> dict[str, Path]:
        """The confidence volume beside the map."""
        file = path.with_name(path.name.replace("expected_error", "confidence", 1))
        return {"confidence": file} if file != path and file.is_file() else {}

    def read_confidence(self, path: Path, truth: PreparedTruth) -> NDArray[Any]:
        """Confidence at the places of the truth."""
        return self._at(path, truth)

    def curves(self, estimate: Errors, truth: PreparedTruth, confidences: Mapping[str, NDArray[Any]]) -> list[Curve]:
        """Sparsification of the true error by each confidence."""
        mask, wrong = _mask(truth), self.wrong(estimate, truth)
        made = []
        for name, values in confidences.items():
            made.append(Curve(mask, name, "error", sparsification(values, truth.error)))
            made.append(Curve(mask, name, "bad", sparsification(values, wrong)))
        return made

    def evidence(self, estimate: Errors, truth: PreparedTruth) -> tuple[str, Errors, Errors]:
        """Expected and true errors, of evenly spread voxels where there are very many."""
        step = max(1, len(estimate) // _KEPT)
        return _mask(truth), estimate[::step], truth.error[::step]

    def mean(self, results: Sequence[Result]) -> list[Score]:
        """Every measure over all points of the scenes together; where an scene lacks a map, the mean of the scores."""
        if any(result.evidence is None for result in results) or not results:
            return super().mean(results)
        made = []
        for mask in dict.fromkeys(result.evidence[0] for result in results):
            chosen = [result.evidence for result in results if result.evidence[0] == mask]
            expected, true = (np.concatenate([evidence[k] for evidence in chosen]) for k in (1, 2))
            made += _scores(self.spearman, mask, expected, true)
        return made

    def tables(self, section: Section) -> list[Table]:
        """And the confusion of classes, and expected against true error in bins."""
        made = super().tables(section)
        for run in section.runs:
            chosen = [r.evidence for r in section.results if r.run == run and r.evidence is not None]
            if chosen:
                expected, true = (np.concatenate([evidence[k] for evidence in chosen]) for k in (1, 2))
                made += [_confusion(run, expected, true), _calibration(run, expected, true)]
        return made


def _mask(truth: PreparedTruth) -> str:
    return "landmarks" if truth.inside is None else "voxels"


def _scores(spearman: Measure, mask: str, expected: Errors, true: Errors) -> list[Score]:
    known = np.isfinite(expected)
    density, count = percent(int(known.sum()), len(true)), int(known.sum())
    e, t = expected[known].astype(np.float64), true[known].astype(np.float64)
    ordered = np.sort(true.astype(np.float64))
    worst = ordered[-max(1, round(_ROBUST * len(true))) :]
    wrong = t > LIMITS[0]
    line = sparsification(-e, t) if count else None
    values = (
        (spearman, correlation(ranks(e), ranks(t))),
        (Measure("Pearson", "", worst=-1.0, larger_is_better=True), correlation(e, t)),
        (Measure("AUC", "", LIMITS[0], worst=0.0, larger_is_better=True), area(e, wrong)),
        (
            Measure("accuracy", "%", worst=0.0, larger_is_better=True),
            100 * float(np.mean(classes(e) == classes(t))) if count else np.nan,
        ),
        (Measure("MAE", "mm"), float(np.abs(e - t).mean()) if count else np.nan),
        (Measure("expected", "mm"), float(e.mean()) if count else np.nan),
        (Measure("AUSE", "mm"), np.nan if line is None else line.ause),
        (Measure("AURG", "mm", larger_is_better=True), np.nan if line is None else line.aurg),
        (Measure("TRE", "mm"), float(ordered.mean())),
        (Measure("TRE std", "mm"), float(ordered.std())),
        (Measure("TRE30", "mm"), float(worst.mean())),
    )
    return [Score(measure, mask, value, count, density) for measure, value in values]


def ranks(values: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Ranks from 1, equal values sharing their mean."""
    _, inverse, counts = np.unique(values, return_inverse=True, return_counts=True)
    last = np.cumsum(counts)
    shared: NDArray[np.float64] = (last - (counts - 1) / 2.0)[inverse]
    return shared


def correlation(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    """Pearson's coefficient; NaN where one of the two does not vary."""
    if len(one) < 2 or np.ptp(one) == 0 or np.ptp(other) == 0:
        return float("nan")
    return float(np.corrcoef(one, other)[0, 1])


def area(score: NDArray[np.float64], bad: NDArray[np.bool_]) -> float:
    """Area under the ROC curve of ``score`` for ``bad``; NaN where all are alike."""
    count = int(bad.sum())
    if count in (0, len(bad)):
        return float("nan")
    return float((ranks(score)[bad].sum() - count * (count + 1) / 2) / (count * (len(bad) - count)))


def classes(error: NDArray[np.floating[Any]]) -> NDArray[np.int64]:
    """0 below 3 mm, 1 below 6 mm, 2 from there on."""
    found: NDArray[np.int64] = np.digitize(error, LIMITS)
    return found


def _confusion(run: str, expected: Errors, true: Errors) -> Table:
    known = np.isfinite(expected)
    e, t = classes(expected[known]), classes(true[known])
    names = ("< 3 mm", "3-6 mm", ">= 6 mm")
    rows = tuple((name, *(str(int(np.sum((t == k) & (e == j)))) for j in range(3))) for k, name in enumerate(names))
    return Table(f"{run}: true (rows) and expected (columns) class", ("true", *names), rows)


def _calibration(run: str, expected: Errors, true: Errors) -> Table:
    known = np.isfinite(expected)
    e, t = expected[known], true[known]
    order = np.argsort(e, kind="stable")
    rows = [
        (number(float(e[part].mean())), number(float(t[part].mean())), str(len(part)))
        for part in np.array_split(order, min(8, len(order)))
        if len(part)
    ]
    title = f"{run}: expected against true error, in bins of equal size"
    return Table(title, ("expected mm", "true mm", "points"), tuple(rows))
