"""Registrations of volumes: ``registration_confidence`` estimates where they are wrong, and by how much."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from depthcli.algorithms.body import body, body_of_volume
from depthcli.algorithms.error_table import ErrorTable
from depthcli.algorithms.resampling import block_means, trilinear
from depthcli.api.inputs import Overrides, as_volume, load_config
from depthcli.api.saving import made
from depthcli.core.bound import VolumeBound
from depthcli.core.errors import InputError
from depthcli.core.result import Clock
from depthcli.core.volumes import Grid
from depthcli.io.formats.files import write_text
from depthcli.io.formats.images import png_bytes, write_png
from depthcli.io.formats.networks import read_errors
from depthcli.io.formats.volumes import simple_itk, write_volume
from depthcli.io.volume_pairs import LoadedPair, blocks_of, joined, usable
from depthcli.kernels.jit import one_at_a_time
from depthcli.methods.registration.config import RegisterConfidenceConfig
from depthcli.methods.registration.pipeline import RegistrationResult, at_voxels
from depthcli.run.resources import available_memory, check_memory
from depthcli.show.table import to_csv
from depthcli.show.volumes import draw_volumes

_USUAL = VolumeBound()
_MAX_BORDER_SHARE = 0.2  # of best matches on the border of the search; above it errors exceed its range
_WRONG_MM = 3.0  # expected errors above it are located
_DECIMALS = {"confidence": 5, "probability": 5}  # of columns of the table of landmarks; of others 4


@dataclass(frozen=True, eq=False, repr=False)
class RegistrationConfidence:
    """Expected errors of a registration, on the grid of the fixed volume."""

    loaded: LoadedPair  # the pair as it was compared, maybe as means of blocks
    details: RegistrationResult  # what the method returns, on its own grid of measured voxels
    bounds: Mapping[str, NDArray[np.float32]]  # bound and probability on that grid; empty: the method gives none
    seconds: Mapping[str, float]  # stage -> time
    warnings: tuple[str, ...] = ()  # what looks wrong, one line each
    neurological: bool = False  # pictures have the patient's right on the right

    @property
    def grid(self) -> Grid:
        """Positions of the fixed volume's voxels, mm, in the LPS frame of ITK."""
        return self.loaded.grid

    @cached_property
    def values(self) -> NDArray[np.float32]:
        """(Z, Y, X) float32, mm: the expected error."""
        return self._on_fixed_grid(self.details.expected_error)

    @cached_property
    def confidence(self) -> NDArray[np.float32]:
        """(Z, Y, X) float32 in [0, 1]: exp(-expected error / 3 mm)."""
        return self._on_fixed_grid(self.details.certainty)

    @cached_property
    def bound(self) -> NDArray[np.float32]:
        """(Z, Y, X) float32, mm: a share ``level`` of the errors is not larger; InputError without one.

        Where it is ``details.figures["reach"]``, as far as matches were searched for, it may be any larger number.
        """
        return self._bounds("bound")

    @cached_property
    def probability(self) -> NDArray[np.float32]:
        """(Z, Y, X) float32: of an error up to ``within`` mm; InputError without one."""
        return self._bounds("probability")

    @cached_property
    def shift(self) -> NDArray[np.float32]:
        """(Z, Y, X, 3) float32, mm along x, y, z: where the match of a voxel lies; InputError without one."""
        return self._shift()

    def at(self, points: ArrayLike) -> list[dict[str, float]]:
        """Return position, confidence, expected error, and any shift, bound and probability, of points; a row for each.

        The points are (N, 3) positions x, y, z, mm.
        """
        places = np.asarray(points, np.float64)
        if places.ndim != 2 or places.shape[1] != 3:
            raise InputError(f"points: expected (N, 3) positions in mm, got {places.shape}")
        starts, steps = self.loaded.on_grid(self.details.start, self.details.step)
        found = (self.grid.to_index(places) - np.array(starts)) / np.array(steps)
        columns: dict[str, NDArray[Any]] = dict(zip("xyz", places.T, strict=True))
        columns["confidence"] = trilinear(self.details.certainty, found)
        columns["expected_error"] = trilinear(self.details.expected_error, found)
        if self.details.shift is not None:
            own = np.stack([trilinear(self.details.shift[axis], found) for axis in (2, 1, 0)], axis=-1)
            columns |= zip(("shift_x", "shift_y", "shift_z"), (own @ self.grid.axes.T).T, strict=True)
        columns |= {name: trilinear(values, found) for name, values in self.bounds.items()}
        return [
            {name: round(float(v), _DECIMALS.get(name, 4)) for name, v in zip(columns, row, strict=True)}
            for row in zip(*columns.values(), strict=True)
        ]

    def save(self, folder: str | Path, suffix: str = ".nii.gz", landmarks: ArrayLike | None = None) -> None:
        """Write the files that ``depthcli register-confidence`` writes for a scene, with the same bytes.

        The folder is created where it is missing; volumes have the suffix ``.nii.gz``, ``.nii``, ``.mha`` or ``.nrrd``;
        landmarks, (N, 3) positions x, y, z, mm, are for the table ``points.csv``, where a bound that ends with the
        search is ``> 14``.
        """
        if suffix not in (".nii.gz", ".nii", ".mha", ".nrrd"):
            raise InputError(f"suffix: must be .nii.gz, .nii, .mha or .nrrd (got {suffix!r})")
        files = made(folder)
        maps = {"confidence": self.details.certainty, "expected_error": self.details.expected_error, **self.bounds}
        for name, values in maps.items():
            write_volume(files / f"{name}{suffix}", self.grid, partial(self._on_fixed_grid, values))
        if self.details.shift is not None:
            write_volume(files / f"shift{suffix}", self.grid, self._shift, vector=True)
        write_png(files / "preview.png", self._preview())
        if landmarks is not None:
            reach = round(self.details.figures.get("reach", math.inf), 4)
            rows: list[dict[str, Any]] = list(self.at(landmarks))
            for row in rows:
                if row.get("bound", 0) >= reach:
                    row["bound"] = f"> {reach:g}"
            write_text(files / "points.csv", to_csv(rows))

    def _on_fixed_grid(
        self, values: NDArray[np.float32], first: int = 0, last: int | None = None
    ) -> NDArray[np.float32]:
        """Return slices ``first`` .. ``last`` (None: all) of a map of the method, on the fixed volume's grid."""
        depth, height, width = self.grid.shape
        place = self.loaded.on_grid(self.details.start, self.details.step)
        shape = ((depth if last is None else last) - first, height, width)
        return at_voxels(values, *place, shape, (first, 0, 0))

    def _bounds(self, name: str) -> NDArray[np.float32]:
        if name not in self.bounds:
            raise InputError(f"{name}: this pipeline gives no score of the error, so there is none")
        return self._on_fixed_grid(self.bounds[name])

    def _shift(self, first: int = 0, last: int | None = None) -> NDArray[np.float32]:
        if self.details.shift is None:
            raise InputError("shift: this pipeline searches for no matches, so there is none")
        parts = [self._on_fixed_grid(self.details.shift[axis], first, last) for axis in (2, 1, 0)]
        return np.asarray(np.stack(parts, axis=-1) @ self.grid.axes.T, np.float32)

    def _preview(self) -> NDArray[np.uint8]:
        result, pair = self.details, self.loaded.pair
        volumes = {"fixed": pair.fixed, "moving, registered": pair.warped}
        errors = {"expected error": result.expected_error}
        if "bound" in self.bounds:
            errors["bound of the error"] = self.bounds["bound"]
        maps = {title: partial(at_voxels, values, result.start, result.step) for title, values in errors.items()}
        inside = body if pair.mask is None else pair.mask
        return draw_volumes(volumes, self.grid, self.loaded.blocks, maps, inside, self.neurological)

    def __repr__(self) -> str:
        error, size = self.details.figures["mean_error"], " x ".join(map(str, self.grid.size))
        above = "> " * beyond_search(self.details.figures)
        return f"RegistrationConfidence({size} voxels, {above}{error:.2f} mm expected)"

    def _repr_png_(self) -> bytes:
        return png_bytes(self._preview())


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
    """Return expected error, bound, confidence and shift of every voxel of a registration, from the registered volumes.

    ConfigError for an unknown preset, or keys and values that do not fit; InputError for volumes of different grids,
    with values that are no numbers, or that are the same everywhere, or too little memory.

    Parameters
    ----------
    fixed, warped : the fixed volume, and the moving one after registration on the same grid: (Z, Y, X) arrays, or
        images of SimpleITK, which have their geometry with them
    spacing : distance (z, y, x) of the voxels of arrays, mm: ``image.GetSpacing()[::-1]`` of SimpleITK
    preset : name of a preset of ``depthcli register-confidence``, path of a YAML file, or a config
    overrides : config keys -> values, as ``--set`` has them
    origin : of arrays: position x, y, z of the first voxel, mm
    direction : of arrays: (3, 3), whose columns are the axes x, y, z, as in ITK; None: the axes of the frame
    mask : (Z, Y, X) or image, > 0 where voxels are of interest; None: all
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
    config = load_config(RegisterConfidenceConfig, preset, overrides, **fields)
    clock = Clock()
    clock.start("load")
    grid, first = _volume(fixed, "fixed", spacing, origin, direction)
    grids = {"fixed": grid}
    grids["warped"], second = _volume(warped, "warped", spacing, origin, direction)
    inside = None
    if mask is not None:
        grids["mask"], chosen = _volume(mask, "mask", spacing, origin, direction)
        inside = chosen > 0
    for name, own in grids.items():
        if not own.same_as(grid):
            raise InputError(f"{name}: another grid than the fixed volume's ({own.describe_difference(grid)})")
    if inside is not None and not inside.any():
        raise InputError("mask: no voxel is set")
    blocks = blocks_of(grid, config.pipeline.voxel_limit)
    first, second = (block_means(usable(v, inside, n), blocks) for v, n in ((first, "fixed"), (second, "warped")))
    loaded = joined(first, second, inside, grid, blocks)
    with one_at_a_time():
        return measured_pair(config, loaded, clock, available_memory())


def measured_pair(
    config: RegisterConfidenceConfig, loaded: LoadedPair, clock: Clock, memory: int
) -> RegistrationConfidence:
    """Return the expected errors of a pair; the clock books the stages, and ``other``.

    InputError where ``memory`` bytes do not suffice.
    """
    need = peak_bytes(config, loaded.grid, loaded.pair.shape, loaded.pair.spacing)
    check_memory(need, memory, f"{' x '.join(map(str, loaded.grid.size))} voxels", "max_voxels, iso")
    clock.start("other")
    result = config.pipeline(loaded.pair)
    clock.include(result.seconds)
    clock.start("bound")
    bounds: dict[str, NDArray[np.float32]] = {}
    if result.scores:
        table = read_errors(config.pipeline.error_table)
        bounds = bounds_of(result.scores, result.figures["iso"], result.figures["reach"], table, config.bound)
    clock.start("other")
    result.figures.update(inside_figures(result, loaded, bounds.get("bound")))
    warnings = []
    if beyond_search(result.figures):
        warnings.append(
            f"{100 * result.figures['border']:.0f} % of the best matches lie on the border of the search: the "
            "registration may be off by more than its range; a larger levels, radius or iso searches farther"
        )
    if np.array_equal(loaded.pair.fixed, loaded.pair.warped):
        warnings.append("fixed and registered volume are the same: is one of them given twice?")
    return RegistrationConfidence(loaded, result, bounds, dict(clock.seconds), tuple(warnings), config.neurological)


def bounds_of(
    scores: Sequence[NDArray[np.float32]], iso: float, reach: float, table: ErrorTable, promise: VolumeBound
) -> dict[str, NDArray[np.float32]]:
    """Return bound, mm, and probability of the scores of a result, with its figures, by a table of errors in voxels.

    They are those of the finest resolution whose usual bound does not end with its search; empty without scores.
    """
    bounds: dict[str, NDArray[np.float32]] = {}
    for k, score in reversed(list(enumerate(scores))):
        unit = iso * 2**k
        found = {
            "bound": np.minimum(table.bound(score, promise.level) * np.float32(unit), np.float32(reach)),
            "probability": table.probability(score, promise.within / unit),
        }
        if bounds:
            ends = table.bound(score, _USUAL.level) * unit >= reach / 2 ** (len(scores) - 1 - k)
            found = {name: np.where(ends, bounds[name], values) for name, values in found.items()}
        bounds = found
    return bounds


def beyond_search(figures: Mapping[str, Any]) -> bool:
    """Return whether so many of the best matches lie on the border of the search that its errors are lower bounds."""
    return float(figures.get("border", 0.0)) > _MAX_BORDER_SHARE


def peak_bytes(
    config: RegisterConfidenceConfig, grid: Grid, shape: tuple[int, int, int], spacing: tuple[float, float, float]
) -> int:
    """Return an estimate of the peak memory of a pair that is loaded as ``shape`` voxels, bytes."""
    voxels = shape[0] * shape[1] * shape[2]
    # Beside the pipeline's memory two volumes of 4 bytes per voxel.
    working = config.pipeline.peak_bytes(shape, spacing) + 8 * voxels
    reading = 6 * grid.size[0] * grid.size[1] * grid.size[2]  # one whole volume, 2 bytes as stored and 4 converted
    return max(working, reading)


def inside_figures(
    result: RegistrationResult, loaded: LoadedPair, bound: NDArray[np.float32] | None = None
) -> dict[str, float]:
    """Return figures of the expected error in the mask, or else in the body; empty where no voxel lies there.

    They are ``inside_mean``, ``inside_95`` (quantile), ``inside_max``, mm; ``above_3mm``, mL of larger errors; where
    there are any, ``above_x``, ``above_y`` and ``above_z``: center of their largest connected region, mm, LPS. Of a
    bound ``inside_bound``, its median, mm, and ``at_reach``, the share of voxels where it ends with the search.
    """
    pair, grid = loaded.pair, loaded.grid
    inside = pair.mask
    if inside is None:
        order, flipped = grid.anatomical_axes()
        turned = np.flip(body_of_volume(grid.turned(pair.fixed)), flipped)
        inside = turned.transpose(np.argsort(order))
    error = at_voxels(result.expected_error, result.start, result.step, pair.shape)
    known = error[inside]
    if not known.size:
        return {}
    wrong = inside & (error > _WRONG_MM)
    figures = {"inside_mean": float(known.mean(dtype=np.float64)), "inside_95": float(np.quantile(known, 0.95))}
    figures["inside_max"] = float(known.max())
    figures["above_3mm"] = int(np.count_nonzero(wrong)) * math.prod(pair.spacing) / 1000
    if wrong.any():
        labels, _ = ndimage.label(wrong)
        largest = int(np.bincount(labels[wrong]).argmax())
        center = np.array([ndimage.center_of_mass(labels == largest)])
        first, blocks = (np.array(values) for values in loaded.on_grid((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)))
        place = grid.to_point(first + blocks * center)[0]
        figures |= dict(zip(("above_x", "above_y", "above_z"), map(float, place), strict=True))
    if bound is not None:
        within = at_voxels(bound, result.start, result.step, pair.shape)[inside]
        figures["inside_bound"] = float(np.median(within))
        figures["at_reach"] = float(np.mean(within >= bound.dtype.type(result.figures["reach"])))
    return {name: round(value, 4) for name, value in figures.items()}


def _volume(
    volume: Any,
    name: str,
    spacing: tuple[float, float, float] | None,
    origin: tuple[float, float, float],
    direction: ArrayLike | None,
) -> tuple[Grid, NDArray[np.float32]]:
    axes = np.eye(3) if direction is None else np.asarray(direction, np.float64)
    if all(hasattr(volume, method) for method in ("GetSpacing", "GetOrigin", "GetDirection")):  # of SimpleITK
        values = as_volume(simple_itk().GetArrayFromImage(volume), name)
        given, placed = volume.GetSpacing(), volume.GetOrigin()
        axes = np.reshape(volume.GetDirection(), (len(given), len(given)))
        if len(given) == 2:
            given, placed, axes = (*given, 1.0), (*placed, 0.0), np.pad(axes, (0, 1))
            axes[2, 2] = 1.0
    else:
        values = as_volume(volume, name)
        if spacing is None:
            raise InputError(f"{name}: an array needs its spacing (z, y, x) in mm beside it")
        given, placed = tuple(spacing)[::-1], tuple(origin)
    numbers = np.array([*given, *placed, *axes.ravel()], np.float64)
    if numbers.shape != (15,) or not np.isfinite(numbers).all() or min(given) <= 0 or abs(np.linalg.det(axes)) < 1e-6:
        raise InputError(f"{name}: expected three positive spacings, an origin of three numbers and three axes")
    x, y, z = (float(v) for v in given)
    at = (float(placed[0]), float(placed[1]), float(placed[2]))
    depth, height, width = values.shape
    return Grid((width, height, depth), (x, y, z), at, tuple(map(float, axes.ravel()))), values
