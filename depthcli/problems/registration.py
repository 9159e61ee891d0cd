"""Estimate the error of a registration at every voxel, with an error bound and the better match."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field
from scipy import ndimage

from depthcli.algorithms.body import body, body_of_volume
from depthcli.algorithms.error_table import ErrorTable
from depthcli.algorithms.resampling import block_means, trilinear
from depthcli.core.bound import VolumeBound
from depthcli.core.context import Context
from depthcli.core.errors import InputError
from depthcli.core.maps import VolumeStatus
from depthcli.core.method import RootConfig
from depthcli.core.volumes import Grid
from depthcli.io.formats.files import made, write_text
from depthcli.io.formats.images import png_bytes, write_drawn
from depthcli.io.formats.networks import read_errors
from depthcli.io.formats.volumes import simple_itk, write_volume, written_suffix
from depthcli.io.scenes import VolumePairScene
from depthcli.io.scenes.volumes import VOLUMES
from depthcli.io.volume_pairs import (
    LoadedPair,
    blocks_of,
    joined,
    landmarks,
    load_volumes,
    loaded_size,
    region_masks,
    usable,
)
from depthcli.methods.registration.pipeline import Pipeline, RegistrationResult, at_voxels
from depthcli.methods.registration.pipeline.search import RegistrationSearch
from depthcli.problems.inputs import Overrides, as_volume, load_config
from depthcli.problems.problem import Inputs, Problem, Shown
from depthcli.run.job import available_memory, check_memory
from depthcli.show.table import Column, Row, number, percent, to_csv
from depthcli.show.volumes import draw_volumes

_MAX_BORDER_SHARE = 0.2  # share of best matches on the border of the search, beyond which errors exceed its range
_WRONG_MM = 3.0  # expected errors above this count as large
_DECIMALS = {"confidence": 5, "probability": 5}  # in the landmark table; other columns have 4
_SUFFIXES = (".nii.gz", ".nii", ".mha", ".nrrd")
_NUMBERED = re.compile(r"(.+)_\d+")  # name of a region with an unnamed label


class RegisterConfidenceConfig(RootConfig):
    """A pipeline with its parameters."""

    command: ClassVar[str] = "register-confidence"

    pipeline: Pipeline = Field(RegistrationSearch(), description="the data flow from registered pair to expected error")
    bound: VolumeBound = Field(VolumeBound(), description="error bound, and probability of a small error")
    field: str = Field(
        "auto",
        pattern="^(auto|itk|ants|niftyreg|positions|voxels)$",
        description="convention of displacement files; auto: from the header, checked against the others",
    )
    neurological: bool = Field(
        False, description="pictures have the patient's right on the right, otherwise on the left"
    )
    figure: Literal["dark", "light"] = Field("dark", description="background of preview.png; light: white, for print")
    slice_at: tuple[float, float, float] | None = Field(
        None, description="point x, y, z, mm LPS, that the slices of preview.png go through; null: the middle"
    )

    def peak_bytes(self, grid: Grid, shape: tuple[int, int, int], spacing: tuple[float, float, float]) -> int:
        """Return an estimate of the peak memory, in bytes, for a pair loaded as ``shape`` voxels."""
        # The pipeline's memory and two volumes of 4 bytes per voxel.
        working = self.pipeline.peak_bytes(shape, spacing) + 8 * math.prod(shape)
        reading = 6 * math.prod(grid.size)  # one full-size volume: 2 stored bytes and 4 converted bytes per voxel
        return max(working, reading)


@dataclass(frozen=True, eq=False, repr=False)
class RegistrationConfidence:
    """Expected errors of a registration, on the fixed volume's grid."""

    loaded: LoadedPair  # the compared pair, possibly reduced to block means
    details: RegistrationResult  # the method's results, on its own grid of measured voxels
    bounds: Mapping[str, NDArray[np.float32]]  # bound and probability on that grid; empty if the method has none
    seconds: Mapping[str, float]  # stage -> time
    warnings: tuple[str, ...] = ()  # one line per warning
    neurological: bool = False  # pictures have the patient's right on the right
    figure: str = "dark"  # background of pictures, "dark" or "light"
    slice_at: tuple[float, float, float] | None = None  # point of the slices in pictures, mm, LPS; None: the center

    @property
    def grid(self) -> Grid:
        """The fixed volume's grid, mm, in ITK's LPS frame."""
        return self.loaded.grid

    @cached_property
    def values(self) -> NDArray[np.float32]:
        """The expected error, (Z, Y, X) float32, mm."""
        return self._map("expected_error")

    @cached_property
    def confidence(self) -> NDArray[np.float32]:
        """The confidence exp(-expected error / 3 mm), (Z, Y, X) float32 in [0, 1]."""
        return self._map("confidence")

    @cached_property
    def bound(self) -> NDArray[np.float32]:
        """The error bound, (Z, Y, X) float32, mm: a share ``level`` of errors is within it.

        It is at least the expected error. It is open (infinite) from ``details.figures["reach"]`` on, the radius of
        the finest search. Raise InputError if the method has no bound.
        """
        return self._map("bound")

    @property
    def status(self) -> NDArray[np.uint8]:
        """Bits of :class:`VolumeStatus`, (Z, Y, X) uint8. Raise InputError without a bound."""
        return _status_of(self.bound)

    @cached_property
    def probability(self) -> NDArray[np.float32]:
        """The probability of an error up to ``within`` mm, (Z, Y, X) float32. Raise InputError without a bound."""
        return self._map("probability")

    @cached_property
    def shift(self) -> NDArray[np.float32]:
        """The offset of each voxel's match, (Z, Y, X, 3) float32, mm along x, y, z. Raise InputError without one."""
        return self._map("shift")

    def at(self, points: ArrayLike) -> list[dict[str, float]]:
        """Return a row per point, with position, confidence, expected error, and any shift, bound and probability.

        The points are (N, 3) positions x, y, z, mm.
        """
        positions = np.asarray(points, np.float64)
        if positions.ndim != 2 or positions.shape[1] != 3:
            raise InputError(f"points: expected (N, 3) positions in mm, got {positions.shape}")
        starts, steps = self.loaded.on_grid(self.details.start, self.details.step)
        places = (self.grid.to_index(positions) - np.array(starts)) / np.array(steps)
        columns: dict[str, NDArray[Any]] = dict(zip("xyz", positions.T, strict=True))
        columns["confidence"] = trilinear(self.details.certainty, places)
        columns["expected_error"] = trilinear(self.details.expected_error, places)
        if self.details.shift is not None:
            shift = np.stack([trilinear(self.details.shift[axis], places) for axis in (2, 1, 0)], axis=-1)
            columns |= zip(("shift_x", "shift_y", "shift_z"), (shift @ self.grid.axes.T).T, strict=True)
        columns |= {name: trilinear(values, places) for name, values in self.bounds.items()}
        if "bound" in columns:
            columns["bound"] = self._opened(columns["bound"], columns["expected_error"])
        return [
            {name: round(float(v), _DECIMALS.get(name, 4)) for name, v in zip(columns, row, strict=True)}
            for row in zip(*columns.values(), strict=True)
        ]

    def save(self, folder: str | Path, suffix: str = ".nii.gz", landmarks: ArrayLike | None = None) -> None:
        """Write the same files as ``depthcli register-confidence``; create the folder if needed.

        Volumes have the suffix ``.nii.gz``, ``.nii``, ``.mha`` or ``.nrrd``. Landmarks, (N, 3) positions x, y, z, mm,
        give the table ``points.csv``, in which an open bound of a 14 mm search is ``> 14``.
        """
        if suffix not in _SUFFIXES:
            raise InputError(f"suffix: must be .nii.gz, .nii, .mha or .nrrd (got {suffix!r})")
        files = made(folder)
        for name in self._maps:
            write_volume(files / f"{name}{suffix}", self.grid, partial(self._map, name), vector=name == "shift")
        if "bound" in self.bounds:

            def status(first: int, last: int) -> NDArray[np.uint8]:
                return _status_of(self._map("bound", first, last))

            write_volume(files / f"status{suffix}", self.grid, status, bytes_=True)
        write_drawn(files / "preview.png", self._preview)
        if landmarks is not None:
            rows: list[Row] = list(self.at(landmarks))
            for row in rows:
                if row.get("bound") == math.inf:
                    row["bound"] = f"> {round(self._reach, 4):g}"
            write_text(files / "points.csv", to_csv(rows))

    def _preview(self) -> NDArray[np.uint8]:
        result, pair = self.details, self.loaded.pair
        volumes = {"fixed": pair.fixed, "moving, registered": pair.warped}
        errors = {"expected error": result.expected_error}
        if "bound" in self.bounds:
            errors["bound of the error"] = self.bounds["bound"]
        maps = {title: partial(at_voxels, values, result.start, result.step) for title, values in errors.items()}
        inside = body if pair.mask is None else pair.mask
        at = None
        if self.slice_at is not None:  # convert to voxels of the loaded volumes
            voxel, blocks = self.grid.to_index(np.array([self.slice_at]))[0], np.array(self.loaded.blocks)
            at = np.rint((voxel - (blocks - 1) / 2) / blocks).astype(int).tolist()
        light = self.figure == "light"
        return draw_volumes(volumes, self.grid, self.loaded.blocks, maps, inside, self.neurological, light, at)

    @property
    def _maps(self) -> dict[str, NDArray[np.float32]]:
        """Name -> map on the method's own grid."""
        maps = {"confidence": self.details.certainty, "expected_error": self.details.expected_error, **self.bounds}
        return maps if self.details.shift is None else {**maps, "shift": self.details.shift}

    def _map(self, name: str, first: int = 0, last: int | None = None) -> NDArray[np.float32]:
        """Return slices ``first`` up to ``last`` (None: all) of a map on the fixed volume's grid.

        Raise InputError if the pipeline has no such map.
        """
        depth, height, width = self.grid.shape
        start_and_step = self.loaded.on_grid(self.details.start, self.details.step)
        shape = ((depth if last is None else last) - first, height, width)
        maps = self._maps
        if name not in maps:
            lack = "searches for no matches" if name == "shift" else "gives no score of the error"
            raise InputError(f"{name}: this pipeline {lack}, so there is none")
        # Bounds are opened after interpolation, since infinity cannot be interpolated.
        parts = {"shift": tuple(maps[name][::-1]), "bound": (maps[name], maps["expected_error"])}.get(
            name, (maps[name],)
        )
        values = [at_voxels(part, *start_and_step, shape, (first, 0, 0)) for part in parts]
        if name == "shift":
            return np.asarray(np.stack(values, axis=-1) @ self.grid.axes.T, np.float32)
        return self._opened(*values) if name == "bound" else values[0]

    def _opened(self, bound: NDArray[np.float32], expected: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return bounds of at least the expected error, +inf where they are open."""
        bound = np.maximum(bound, expected)
        return np.where(bound >= bound.dtype.type(self._reach), np.float32(np.inf), bound)

    @property
    def _reach(self) -> float:
        return self.details.figures.get("reach", math.inf)

    def __repr__(self) -> str:
        error, size = self.details.figures["mean_error"], " x ".join(map(str, self.grid.size))
        above = "> " * _beyond_search(self.details.figures)
        return f"RegistrationConfidence({size} voxels, {above}{error:.2f} mm expected)"

    def _repr_png_(self) -> bytes:
        return png_bytes(self._preview())


def _status_of(bound: NDArray[np.float32]) -> NDArray[np.uint8]:
    return np.where(np.isposinf(bound), np.uint8(VolumeStatus.OPEN_BOUND), np.uint8(0))


def _size(row: Row) -> str:
    return f"{row['width']}x{row['height']}x{row['slices']}" if "slices" in row else "-"


def _center(row: Row) -> str:
    center = [row.get(f"above_{axis}") for axis in "xyz"]
    return " ".join(f"{value:.0f}" for value in center if isinstance(value, int | float)) or "-"


def _error(key: str, form: str, title: str) -> Column:
    """Return the column of an expected error, shown as ``> 14`` if the errors exceed the search range."""
    plain = number(key, form, title)
    return Column(title, lambda row: "> " * (key in row and _beyond_search(row)) + plain.cell(row))


def _bound(row: Row) -> str:
    lower: bool = row.get("at_reach", 0) >= 0.5  # the figure is a median
    return "> " * lower + str(number("inside_bound", "{:.1f}").cell(row))


_COLUMNS = (
    Column("size", _size),
    _error("inside_mean", "{:.2f}", "mean mm"),
    _error("inside_95", "{:.1f}", "95 % mm"),
    _error("inside_max", "{:.1f}", "largest mm"),
    Column("bound mm", _bound),
    number("above_3mm", "{:.1f}", "above 3 mm, mL"),
    Column("center, LPS", _center),
    percent("border", "at border"),
)


@dataclass(frozen=True, eq=False)
class VolumePair(Inputs):
    """A registered pair in memory, with its scene if it has one."""

    loaded: LoadedPair
    scene: VolumePairScene | None = None  # has the regions for further figures
    save_options: Mapping[str, Any] = field(default_factory=dict)
    warnings: Sequence[str] = ()


@dataclass(frozen=True)
class Register(Problem[VolumePairScene, VolumePair, RegistrationConfidence]):
    """Estimate the errors of registrations with a search around every voxel."""

    command = "register-confidence"
    model = RegisterConfidenceConfig
    layouts = VOLUMES
    writes = (
        "confidence.*",
        "expected_error.*",
        "bound.*",
        "probability.*",
        "shift.*",
        "status.*",
        "preview.png",
        "points.csv",
    )
    shown = Shown(_COLUMNS, (_COLUMNS[0], *_COLUMNS[3:]), protocol="registration")

    config: RegisterConfidenceConfig

    def load(self, scene: VolumePairScene, context: Context) -> VolumePair:
        """Return both volumes and the landmarks, with a warning if the landmarks cannot be used."""
        context.clock.start("load")
        loaded = load_volumes(scene, self.config.field, self.config.pipeline.voxel_limit)
        warnings, points = [scene.lacks_for_truth] if scene.lacks_for_truth else [], None
        try:
            points = landmarks(scene, loaded.grid)
        except InputError as problem:  # the maps do not need them
            warnings.append(f"{problem}; no points.csv")
        return VolumePair(loaded, scene, {"suffix": written_suffix(scene.fixed), "landmarks": points}, warnings)

    def solve(self, inputs: VolumePair, context: Context) -> RegistrationConfidence:
        """Return the expected errors; the clock records the stages and ``other``."""
        config, loaded, clock = self.config, inputs.loaded, context.clock
        need = config.peak_bytes(loaded.grid, loaded.pair.shape, loaded.pair.spacing)
        check_memory(need, context.memory, f"{' x '.join(map(str, loaded.grid.size))} voxels", "max_voxels, iso")
        clock.start("other")
        details = config.pipeline(loaded.pair)
        clock.include(details.seconds)
        clock.start("bound")
        bounds: dict[str, NDArray[np.float32]] = {}
        if details.score is not None:
            table, iso = read_errors(config.pipeline.error_table), details.figures["iso"]
            bounds = bounds_of(details.score, details.expected_error, iso, table, config.bound)
        clock.start("other")
        details.figures.update(inside_figures(details, loaded, bounds.get("bound")))
        warnings = []
        if _beyond_search(details.figures):
            warnings.append(
                f"{100 * details.figures['border']:.0f} % of the best matches are on the border of the search: the "
                "registration may be off by more than its range; a larger radius or iso searches farther"
            )
        if np.array_equal(loaded.pair.fixed, loaded.pair.warped):
            warnings.append("fixed and registered volume are the same: is one of them given twice?")
        seconds = dict(clock.seconds)
        shown = config.neurological, config.figure, config.slice_at
        return RegistrationConfidence(loaded, details, bounds, seconds, tuple(warnings), *shown)

    def row(self, inputs: VolumePair, result: RegistrationConfidence) -> Row:
        """Return size, figures, and figures of regions; their masks are read one by one."""
        width, height, slices = result.grid.size
        row: Row = {"width": width, "height": height, "slices": slices, **result.details.figures}
        if inputs.scene is not None and inputs.scene.regions:
            row |= _region_figures(result.details, inputs.loaded, inputs.scene)
        return row

    def problems(self, rows: Sequence[Row]) -> list[str]:
        """Return a line for each region whose mask could not be used."""
        cells = ((row, value) for row in rows for key, value in row.items() if key.startswith("region_error_"))
        return [f"{row['scene']}: left out, as a region: {value}" for row, value in cells if value]

    def notes(self, scenes: Sequence[VolumePairScene], rows: Sequence[Row]) -> list[str]:
        """Return a line for each label map whose region has a number in some pairs, but not in pairs with one label."""
        start = "region_volume_"
        regions = {str(row["scene"]): {key.removeprefix(start) for key in row if key.startswith(start)} for row in rows}
        masks = {scene.name: {name for name, _ in scene.regions} for scene in scenes if regions.get(scene.name)}
        unmasked = {name for scene, names in regions.items() for name in names - masks.get(scene, set())}
        numbered = {match[1] for name in unmasked if (match := _NUMBERED.fullmatch(name))}
        lines = []
        for name in sorted(numbered):
            if alone := [scene for scene, names in regions.items() if name in names]:
                others = f" and {len(alone) - 1} more" if len(alone) > 1 else ""
                what = f"mask_{name} has one label in {alone[0]}{others}"
                lines.append(f"{what}: the region {name} there, not {name}_1; name its labels in meta.json")
        return lines

    def is_lower_bound(self, row: Row) -> bool:
        """Return whether the errors exceed the search range."""
        return _beyond_search(row)

    def settings(self, scene: VolumePairScene) -> dict[str, str]:
        """Return the names of the labels of label maps."""
        return {"labels": f"{scene.labels}"} if scene.labels else {}

    def memory(self, scene: VolumePairScene) -> int:
        """Return an estimate from the header of the fixed volume."""
        return self.config.peak_bytes(*loaded_size(scene, self.config.pipeline.voxel_limit))


def bounds_of(
    score: NDArray[np.float32], expected: NDArray[np.float32], iso: float, table: ErrorTable, promise: VolumeBound
) -> dict[str, NDArray[np.float32]]:
    """Return bound, mm, and probability for the score of a result, from a table of errors in voxels.

    Bounds are at least the expected error.
    """
    bound = np.maximum(table.bound(score, promise.level) * np.float32(iso), expected)
    return {"bound": bound, "probability": table.probability(score, promise.within / iso)}


def inside_figures(
    result: RegistrationResult, loaded: LoadedPair, bound: NDArray[np.float32] | None = None
) -> dict[str, float]:
    """Return figures of the expected error in the mask, or in the body without a mask; empty if there are no voxels.

    They are ``inside_mean``, ``inside_95`` (quantile) and ``inside_max``, mm; ``above_3mm``, the volume of larger
    errors, mL; and ``above_x``, ``above_y`` and ``above_z``, the center of their largest connected region, mm, LPS, if
    there is one. With a bound, there are ``inside_bound``, its median, mm, and ``at_reach``, the share of voxels where
    it is open.
    """
    pair, grid = loaded.pair, loaded.grid
    inside = pair.mask
    if inside is None:
        order, flipped = grid.anatomical_axes()
        turned = np.flip(body_of_volume(grid.turned(pair.fixed)), flipped)
        inside = turned.transpose(np.argsort(order))
    error = at_voxels(result.expected_error, result.start, result.step, pair.shape)
    errors = error[inside]
    if not errors.size:
        return {}
    wrong = inside & (error > _WRONG_MM)
    figures = {"inside_mean": float(errors.mean(dtype=np.float64)), "inside_95": float(np.quantile(errors, 0.95))}
    figures["inside_max"] = float(errors.max())
    figures["above_3mm"] = int(np.count_nonzero(wrong)) * math.prod(pair.spacing) / 1000
    if wrong.any():
        labels, _ = ndimage.label(wrong)
        largest = int(np.bincount(labels[wrong]).argmax())
        center = np.array([ndimage.center_of_mass(labels == largest)])
        first, blocks = (np.array(values) for values in loaded.on_grid((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)))
        position = grid.to_point(first + blocks * center)[0]
        figures |= dict(zip(("above_x", "above_y", "above_z"), map(float, position), strict=True))
    if bound is not None:
        within = at_voxels(bound, result.start, result.step, pair.shape)[inside]
        reach = bound.dtype.type(result.figures["reach"])
        figures["inside_bound"] = float(np.median(np.minimum(within, reach)))
        figures["at_reach"] = float(np.mean(within >= reach))
    return {name: round(value, 4) for name, value in figures.items()}


def _region_figures(result: RegistrationResult, loaded: LoadedPair, scene: VolumePairScene) -> dict[str, float | str]:
    """Return figures of the expected error in a pair's regions, such as organs.

    They are ``region_mean_NAME`` and ``region_95_NAME`` (quantile), mm, and ``region_volume_NAME``, mL. Regions without
    voxels have only a volume. ``region_error_NAME`` is the reason if a mask cannot be used; the other masks are used.
    """
    figures: dict[str, float | str] = {}
    error = at_voxels(result.expected_error, result.start, result.step, loaded.pair.shape)
    voxel = math.prod(loaded.grid.spacing) / 1000
    for file, _ in scene.regions:
        try:
            for name, mask in region_masks(scene, file, loaded.grid):
                if f"region_volume_{name}" in figures:
                    twice = f"{scene.folder}: two regions are called {name}: give one of them another name"
                    figures.setdefault(f"region_error_{file}", twice)
                    continue
                chosen = mask
                if max(loaded.blocks) > 1:  # blocks at least half inside the mask; for a small mask, its fullest blocks
                    shares = block_means(mask, loaded.blocks)
                    chosen = (shares > 0) & (shares >= min(0.5, float(shares.max())))
                errors = error[chosen]
                figures[f"region_volume_{name}"] = round(int(np.count_nonzero(mask)) * voxel, 4)
                if errors.size:
                    figures[f"region_mean_{name}"] = round(float(errors.mean(dtype=np.float64)), 4)
                    figures[f"region_95_{name}"] = round(float(np.quantile(errors, 0.95)), 4)
        except InputError as problem:
            figures[f"region_error_{file}"] = str(problem)
    return figures


def _beyond_search(figures: Mapping[str, Any]) -> bool:
    """Return whether so many best matches are on the border of the search that its errors are lower bounds."""
    return float(figures.get("border", 0.0)) > _MAX_BORDER_SHARE


def registration_confidence(
    fixed: Any,
    warped: Any,
    spacing: tuple[float, float, float] | None = None,
    preset: str | Path | RegisterConfidenceConfig = "mind",
    overrides: Overrides | None = None,
    *,
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
    direction: ArrayLike | None = None,
    mask: Any = None,
    **fields: object,
) -> RegistrationConfidence:
    """Return expected error, bound, confidence and shift of a registration at every voxel.

    Raise ConfigError for an unknown preset, unknown keys or invalid values; raise InputError for volumes of different
    grids, non-finite or constant values, or too little memory.

    Parameters
    ----------
    fixed, warped : the fixed volume, and the moving volume after registration on the same grid: (Z, Y, X) arrays, or
        SimpleITK images, which contain their geometry
    spacing : for arrays: voxel spacing (z, y, x), mm, as SimpleITK's ``image.GetSpacing()[::-1]``
    preset : name of a preset of ``depthcli register-confidence``, path of a YAML file, or a config
    overrides : config keys -> values, as in ``--set``
    origin : for arrays: position x, y, z of the first voxel, mm
    direction : for arrays: (3, 3), whose columns are the axes x, y, z, as in ITK; None: the identity
    mask : (Z, Y, X) array or image, > 0 for voxels of interest; None: all
    **fields : config keys that are Python names, such as ``radius=4``

    Examples
    --------
    >>> import depthcli, numpy as np
    >>> fixed = np.random.default_rng(0).random((20, 24, 24), np.float32)
    >>> right = depthcli.registration_confidence(fixed, fixed, spacing=(2, 1, 1), preset="intensity")
    >>> wrong = depthcli.registration_confidence(fixed, np.roll(fixed, 3, axis=2), (2, 1, 1), "intensity")
    >>> bool(right.values.mean() < wrong.values.mean())
    True
    """
    config, context = load_config(RegisterConfidenceConfig, preset, overrides, **fields), Context()
    context.clock.start("load")
    given = {"fixed": fixed, "warped": warped} | ({} if mask is None else {"mask": mask})
    volumes = {name: _volume(volume, name, spacing, origin, direction) for name, volume in given.items()}
    grids = {name: grid for name, (grid, _) in volumes.items()}
    for name, grid in grids.items():
        if not grid.same_as(grids["fixed"]):
            difference = grid.describe_difference(grids["fixed"])
            raise InputError(f"{name}: another grid than the fixed volume's ({difference})")
    inside = volumes.pop("mask")[1] > 0 if mask is not None else None
    if inside is not None and not inside.any():
        raise InputError("mask: no voxel is set")
    grid = grids["fixed"]
    blocks = blocks_of(grid, config.pipeline.voxel_limit)
    first, second = (block_means(usable(volumes.pop(name)[1], inside, name), blocks) for name in ("fixed", "warped"))
    loaded = joined(first, second, inside, grid, blocks)
    context.memory = available_memory()
    return Register(config).solve(VolumePair(loaded), context)


def _volume(
    volume: Any,
    name: str,
    spacing: tuple[float, float, float] | None,
    origin: tuple[float, float, float],
    direction: ArrayLike | None,
) -> tuple[Grid, NDArray[np.float32]]:
    """Return grid and values of an array or SimpleITK image."""
    axes = np.eye(3) if direction is None else np.asarray(direction, np.float64)
    if all(hasattr(volume, method) for method in ("GetSpacing", "GetOrigin", "GetDirection")):  # a SimpleITK image
        values = as_volume(simple_itk().GetArrayFromImage(volume), name)
        steps, first = volume.GetSpacing(), volume.GetOrigin()
        axes = np.reshape(volume.GetDirection(), (len(steps), len(steps)))
        if len(steps) == 2:
            steps, first, axes = (*steps, 1.0), (*first, 0.0), np.pad(axes, (0, 1))
            axes[2, 2] = 1.0
    else:
        values = as_volume(volume, name)
        if spacing is None:
            raise InputError(f"{name}: an array needs its spacing (z, y, x), mm")
        steps, first = tuple(spacing)[::-1], tuple(origin)
    numbers = np.array([*steps, *first, *axes.ravel()], np.float64)
    if numbers.shape != (15,) or not np.isfinite(numbers).all() or min(steps) <= 0 or abs(np.linalg.det(axes)) < 1e-6:
        raise InputError(f"{name}: expected three positive spacings, an origin of three numbers and three axes")
    x, y, z = (float(v) for v in steps)
    at = (float(first[0]), float(first[1]), float(first[2]))
    depth, height, width = values.shape
    return Grid((width, height, depth), (x, y, z), at, tuple(map(float, axes.ravel()))), values
