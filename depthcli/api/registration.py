"""Registrations of volumes: ``registration_confidence`` estimates where they are wrong, and by how much."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from depthcli.algorithms.resampling import block_means
from depthcli.api import _save_registration as _save
from depthcli.api._registration_figures import inside_figures
from depthcli.api._registration_preview import registration_preview
from depthcli.api._save import made
from depthcli.api.arrays import as_volume
from depthcli.api.config import Overrides, load_config
from depthcli.api.running import computing
from depthcli.api.wording import worded
from depthcli.core.errors import InputError
from depthcli.core.result import Clock
from depthcli.core.volumes import Grid
from depthcli.io.formats.images import png_bytes
from depthcli.io.formats.volumes import simple_itk
from depthcli.io.registered_volumes import LoadedPair, blocks_of, joined, usable
from depthcli.methods.registration.config import RegisterConfidenceConfig
from depthcli.methods.registration.pipeline import RegistrationResult
from depthcli.run.resources import available_memory, check_memory

_MAX_BORDER_SHARE = 0.2  # of best matches on the border of the search; above it errors exceed its range


@dataclass(frozen=True, eq=False, repr=False)
class RegistrationConfidence:
    """Expected errors of a registration, on the grid of the fixed volume.

    Attributes
    ----------
    loaded : the pair as it was compared, maybe as means of blocks
    details : what the method returns, on its own grid of measured voxels
    seconds : stage -> time
    warnings : what looks wrong, one line each
    neurological : pictures have the patient's right on the right
    """

    loaded: LoadedPair
    details: RegistrationResult
    seconds: Mapping[str, float]
    warnings: tuple[str, ...] = ()
    neurological: bool = False

    @property
    def grid(self) -> Grid:
        """Positions of the fixed volume's voxels, mm, in the LPS frame of ITK."""
        return self.loaded.grid

    @cached_property
    def values(self) -> NDArray[np.float32]:
        """(Z, Y, X) float32, mm: the expected error."""
        return _save.on_fixed_grid(self.details, self.loaded, self.details.expected_error)

    @cached_property
    def confidence(self) -> NDArray[np.float32]:
        """(Z, Y, X) float32 in [0, 1]: exp(-expected error / 3 mm)."""
        return _save.on_fixed_grid(self.details, self.loaded, self.details.certainty)

    @cached_property
    def shift(self) -> NDArray[np.float32]:
        """(Z, Y, X, 3) float32, mm along x, y, z: where the match of a voxel lies; InputError without one."""
        return _save.shift_on_fixed_grid(self.details, self.loaded)

    def at(self, points: ArrayLike) -> list[dict[str, float]]:
        """Return position, confidence, expected error and any shift at points (N, 3) x, y, z, mm; a row for each."""
        places = np.asarray(points, np.float64)
        if places.ndim != 2 or places.shape[1] != 3:
            raise InputError(f"points: want (N, 3) positions in mm (got {places.shape})")
        return _save.rows_at(self.details, self.loaded, places)

    def save(self, folder: str | Path, suffix: str = ".nii.gz", landmarks: ArrayLike | None = None) -> None:
        """Write the files that ``depthcli register-confidence`` writes for a scene, with the same bytes.

        Parameters
        ----------
        folder : created where it is missing
        suffix : of the volumes: ``.nii.gz``, ``.nii``, ``.mha`` or ``.nrrd``
        landmarks : (N, 3) positions x, y, z, mm, for the table ``points.csv``; None: no table
        """
        if suffix not in (".nii.gz", ".nii", ".mha", ".nrrd"):
            raise InputError(f"suffix: want .nii.gz, .nii, .mha or .nrrd (got {suffix!r})")
        points = None if landmarks is None else np.asarray(landmarks, np.float64)
        _save.save_registration(self.details, self.loaded, points, made(folder), suffix, self.neurological)

    def __repr__(self) -> str:
        error, size = self.details.figures["mean_error"], " x ".join(map(str, self.grid.size))
        return f"RegistrationConfidence({size} voxels, {error:.2f} mm expected)"

    def _repr_png_(self) -> bytes:
        return png_bytes(registration_preview(self.details, self.loaded, self.neurological))


@worded
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
    """Estimate where a registration of two volumes is wrong, from the registered volumes alone.

    Parameters
    ----------
    fixed, warped : the fixed volume, and the moving one after registration on the same grid: (Z, Y, X) arrays, or
        images of SimpleITK, which have their geometry with them
    spacing : distance (z, y, x) of the voxels of arrays, mm
    preset : name of a preset of ``depthcli register-confidence``, path of a YAML file, or a config
    overrides : config keys -> values, as ``--set`` has them
    origin : of arrays: position x, y, z of the first voxel, mm
    direction : of arrays: (3, 3), whose columns are the axes x, y, z, as in ITK; None: the axes of the frame
    mask : (Z, Y, X) or image, > 0 where voxels are of interest; None: all
    **fields : config keys that are Python names, such as ``radius=4``

    Returns
    -------
    Expected error, confidence and shift of every voxel.

    Raises
    ------
    ConfigError
        No such preset, or keys and values that do not fit.
    InputError
        Volumes of different grids, with values that are no numbers, or that are the same everywhere; too little memory.

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
    check_voxels(config, loaded, available_memory())
    with computing():
        return measured_pair(config, loaded, clock)


def measured_pair(config: RegisterConfidenceConfig, loaded: LoadedPair, clock: Clock) -> RegistrationConfidence:
    """Measure a pair; what :func:`registration_confidence` and the command have in common.

    Parameters
    ----------
    clock : books the stages, and ``other``
    """
    clock.start("other")
    result = config.pipeline(loaded.pair)
    result.figures.update(inside_figures(result, loaded))
    clock.include(result.seconds)
    warnings = []
    if result.figures.get("border", 0.0) > _MAX_BORDER_SHARE:
        warnings.append(
            f"{100 * result.figures['border']:.0f} % of the best matches lie on the border of the search: the "
            "registration may be off by more than its range; search farther by --set levels=..., radius=... or iso=..."
        )
    return RegistrationConfidence(loaded, result, dict(clock.seconds), tuple(warnings), config.neurological)


def check_voxels(config: RegisterConfidenceConfig, loaded: LoadedPair, memory: int) -> None:
    """Raise InputError where ``memory`` bytes do not suffice for a pair."""
    need = peak_bytes(config, loaded.grid, loaded.pair.shape, loaded.pair.spacing)
    size = f"{' x '.join(map(str, loaded.grid.size))} voxels"
    check_memory(need, memory, size, "--max-memory, --jobs, max_voxels, iso")


def peak_bytes(
    config: RegisterConfidenceConfig, grid: Grid, shape: tuple[int, int, int], spacing: tuple[float, float, float]
) -> int:
    """Return an estimate of the peak memory of a pair that is loaded as ``shape`` voxels, bytes."""
    voxels = shape[0] * shape[1] * shape[2]
    # Beside the pipeline's memory two volumes of 4 bytes per voxel.
    working = config.pipeline.peak_bytes(shape, spacing) + 8 * voxels
    reading = 6 * grid.size[0] * grid.size[1] * grid.size[2]  # one whole volume, 2 bytes as stored and 4 converted
    return max(working, reading)


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
            raise InputError(f"{name}: an array wants its spacing (z, y, x) in mm beside it")
        given, placed = tuple(spacing)[::-1], tuple(origin)
    numbers = np.array([*given, *placed, *axes.ravel()], np.float64)
    if numbers.shape != (15,) or not np.isfinite(numbers).all() or min(given) <= 0 or abs(np.linalg.det(axes)) < 1e-6:
        raise InputError(f"{name}: want three positive spacings, an origin of three numbers and three axes")
    x, y, z = (float(v) for v in given)
    at = (float(placed[0]), float(placed[1]), float(placed[2]))
    depth, height, width = values.shape
    return Grid((width, height, depth), (x, y, z), at, tuple(map(float, axes.ravel()))), values
