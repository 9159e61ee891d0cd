"""Registered pairs of volumes."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.resampling import block_means
from depthcli.core.errors import ConfigError, InputError
from depthcli.core.volumes import Grid, RegisteredPair, Volume
from depthcli.io.formats import fields, volumes
from depthcli.io.formats.fields import read_landmarks, read_moving_transform
from depthcli.io.formats.files import naming
from depthcli.io.formats.volumes import place, read_grid, read_volume, simple_itk
from depthcli.io.scenes import Scene, name_of

_LABEL_TOLERANCE = 1e-3  # of a whole number: what rounding leaves of a label
_MAX_LABELS = 2000  # more are the gray values of a scan; atlases have some hundreds
_MAX_LABEL = 1 << 24  # whole numbers up to here are exact in float32
_GENERIC_NAMES = ("fixed", "fixed.nii")
LEFT_OUT = {"displacement": "transform", "transform": "displacement", "both": ""}
"""What counts of a displacement field and a transform -> what does not; both: the field first, as ANTs chains them."""


@dataclass(frozen=True)
class LoadedPair:
    """A registered pair in memory."""

    pair: RegisteredPair
    grid: Grid  # the fixed volume's
    blocks: tuple[int, int, int] = (1, 1, 1)  # how many of its voxels (z, y, x) a voxel of ``pair`` is the mean of

    def on_grid(self, start: Sequence[float], step: Sequence[float]) -> tuple[list[float], list[float]]:
        """``start`` and ``step`` of maps in voxels of ``pair`` as those in voxels of the fixed volume."""
        begin = [(n - 1) / 2 + n * a for n, a in zip(self.blocks, start, strict=True)]
        return begin, [n * a for n, a in zip(self.blocks, step, strict=True)]


@dataclass(frozen=True)
class RegistrationTruth:
    """True errors of a registration."""

    grid: Grid  # the fixed volume's
    points: NDArray[np.float64]  # (N, 3) landmarks of the fixed volume, x, y, z in mm; empty where the truth is dense
    error: NDArray[np.float32]  # (N,) mm at the landmarks, or (Z, Y, X) mm, NaN = unknown


@dataclass(frozen=True, kw_only=True)
class VolumePairScene(Scene):
    """The files of one pair.

    Attributes
    ----------
    moving : the moving volume, for which ``transform`` or ``displacement`` (or both) map fixed points; or None
    transform, displacement : see ``io/formats/fields.py``
    regions : (name, file) of masks and label maps of the fixed volume, whose errors are reported apart
    labels : of label maps, (name of the map, ((name of a region, its label), ...))
    landmarks_fixed, landmarks_moving : corresponding points, or None
    """

    fixed: Path  # fixed volume
    moving_warped: Path | None = None  # the moving volume after registration, on the fixed grid; or None
    moving: Path | None = None
    transform: Path | None = None
    displacement: Path | None = None
    mask: Path | None = None  # where the fixed volume is of interest (not 0), or None
    regions: tuple[tuple[str, Path], ...] = ()
    labels: tuple[tuple[str, tuple[tuple[str, int], ...]], ...] = ()
    landmarks_fixed: Path | None = None
    landmarks_moving: Path | None = None
    error_true: Path | None = None  # dense true error, mm, or None

    @classmethod
    def single(cls, values: Mapping[str, Any]) -> Self | None:
        """The pair of ``--fixed`` and ``--warped``, or of ``--moving`` with its transform."""
        roles = {"warped": "moving_warped"} | {name: name for name in ("moving", "displacement", "transform", "mask")}
        files: dict[str, Any] = {role: values[name] for name, role in roles.items() if values.get(name) is not None}
        fixed, apply = values.get("fixed"), values.get("apply")
        both = {"displacement", "transform"} <= files.keys()
        if apply is not None and not (both and apply in LEFT_OUT):
            raise ConfigError(f"--apply: want {', '.join(LEFT_OUT)}, of a pair with --displacement and --transform")
        if fixed is None:
            if files:
                raise ConfigError(f"--{next(n for n in roles if roles[n] in files)} wants --fixed beside it")
            return None
        if "moving_warped" not in files and not (
            "moving" in files and ("displacement" in files or "transform" in files)
        ):
            raise ConfigError("--fixed wants --warped, or --moving with --displacement or --transform, beside it")
        if both and apply is None:
            raise ConfigError("both --displacement and --transform: leave one out, or say which counts by --apply")
        files.pop(LEFT_OUT.get(apply or "", ""), None)
        return cls(name=name_of(fixed, _GENERIC_NAMES), folder=fixed.parent, fixed=fixed, **files)

    @property
    def input_files(self) -> dict[str, Path]:
        """Volumes, transform and the landmarks of the fixed volume, each with the files that its header names."""
        roles = ("fixed", "moving_warped", "moving", "transform", "displacement", "mask", "landmarks_fixed")
        files: dict[str, Path] = {role: file for role in roles if (file := getattr(self, role)) is not None}
        files |= {f"mask_{name}": file for name, file in self.regions}
        for role, file in tuple(files.items()):
            behind = volumes.files_read_with(file) + fields.transform_files_read_with(file)
            files |= {f"{role}: {number}": each for number, each in enumerate(behind, 1)}
        return files

    @property
    def has_truth(self) -> bool:
        """Dense errors, or landmarks and the transform that they are carried over by."""
        landmarks = self.landmarks_fixed is not None and self.landmarks_moving is not None
        return self.error_true is not None or (landmarks and (self.transform or self.displacement) is not None)

    def load(self, convention: str = "auto", max_voxels: int | None = None) -> LoadedPair:
        """Return both volumes on the fixed grid, and the mask; ``convention`` is that of the displacement file.

        Of more than ``max_voxels`` voxels, means of blocks, so that two whole volumes are never in memory; blocks are
        no larger than the cubes that so many voxels of the volume would be.
        """
        self.check()
        fixed = read_volume(self.fixed)
        grid = fixed.grid
        blocks = blocks_of(grid, max_voxels)
        inside = None if self.mask is None else self._read_like(self.mask, grid) > 0
        if inside is not None and not inside.any():
            raise InputError(f"{self.mask}: no voxel is set")
        first = block_means(usable(fixed.values, inside, self.fixed), blocks)
        if self.moving_warped is not None:
            del fixed
            moved, source = self._read_like(self.moving_warped, grid), self.moving_warped
        elif self.moving is not None:
            moved, source = self._warp(fixed, convention)
            del fixed
        else:
            raise InputError(f"{self.folder}: neither moving_warped.* nor moving.* with its transform")
        second = block_means(usable(moved, inside, source), blocks)
        return joined(first, second, inside, grid, blocks)

    def region_masks(self, name: str, grid: Grid) -> Iterator[tuple[str, NDArray[np.bool_]]]:
        """Yield name and mask (Z, Y, X) bool of the regions of one of ``regions``, as :func:`label_masks` does."""
        file = dict(self.regions)[name]
        values = self._read_like(file, grid)
        with naming(file):
            yield from label_masks(values, name, dict(self.labels).get(name, ()))

    def size(self, max_voxels: int | None = None) -> tuple[Grid, tuple[int, int, int], tuple[float, float, float]]:
        """Return the fixed volume's grid, and shape and spacing (z, y, x) of what :meth:`load` gives, by its header."""
        self.check()
        grid = read_grid(self.fixed)
        blocks = blocks_of(grid, max_voxels)
        z, y, x = (-(-n // b) for n, b in zip(grid.shape, blocks, strict=True))
        return grid, (z, y, x), spacing_of(grid, blocks)

    def truth(self, convention: str = "auto") -> RegistrationTruth:
        """Return the true errors: dense where there is such a file, or at the landmarks |T(p) - q|."""
        self.check()
        if not self.has_truth:
            raise InputError(
                f"{self.folder}: {self.name} has no true errors (error_true.*, or landmarks of both with the transform)"
            )
        fixed = read_volume(self.fixed)
        if self.error_true is not None:
            error = self._read_like(self.error_true, fixed.grid)
            if self.mask is not None:
                error = np.where(self._read_like(self.mask, fixed.grid) > 0, error, np.float32(np.nan))
            return RegistrationTruth(fixed.grid, np.zeros((0, 3)), error)
        points = self.landmarks(fixed.grid)
        assert points is not None and self.landmarks_moving is not None
        moving = None if self.moving is None else read_volume(self.moving)
        raw = self.moving is not None and self.moving.suffix.lower() == ".img"
        matches = read_landmarks(self.landmarks_moving, fixed.grid if moving is None else moving.grid, raw)
        if len(points) != len(matches):
            raise InputError(f"{self.landmarks_moving}: {len(matches)} landmarks, but {len(points)} of the fixed one")
        transform = read_moving_transform(self.transform, self.displacement, convention, fixed, moving)
        moved = np.array([transform.TransformPoint(point) for point in points.tolist()])
        return RegistrationTruth(fixed.grid, points, np.linalg.norm(moved - matches, axis=1).astype(np.float32))

    def landmarks(self, grid: Grid) -> NDArray[np.float64] | None:
        """Return (N, 3) landmarks of the fixed volume, mm; None where there are none."""
        if self.landmarks_fixed is None:
            return None
        points = read_landmarks(self.landmarks_fixed, grid, self.fixed.suffix.lower() == ".img")
        places = grid.to_index(points)
        outside = ~np.all((places >= -0.5) & (places <= np.array(grid.shape) - 0.5), axis=1)
        if outside.any():
            raise InputError(
                f"{self.landmarks_fixed}: {int(outside.sum())} of {len(points)} landmarks lie outside the fixed "
                f"volume, the first is point {int(np.flatnonzero(outside)[0]) + 1}"
            )
        return points

    @staticmethod
    def _read_like(file: Path, fixed: Grid) -> NDArray[np.float32]:
        """The values of a volume on the fixed grid."""
        volume = read_volume(file)
        if not volume.grid.same_as(fixed):
            raise InputError(f"{file}: another grid than the fixed volume's ({volume.grid.describe_difference(fixed)})")
        return volume.values

    def _warp(self, fixed: Volume, convention: str) -> tuple[NDArray[np.float32], Path]:
        """The moving volume on the fixed grid, and the file that is to blame where it holds what is no number."""
        sitk = simple_itk()
        assert self.moving is not None
        moving = read_volume(self.moving)
        transform = read_moving_transform(self.transform, self.displacement, convention, fixed, moving)
        image = sitk.GetImageFromArray(moving.values)
        place(image, moving.grid)
        grid, low = fixed.grid, float(moving.values.min())
        placed = grid.size, transform, sitk.sitkLinear, grid.origin, grid.spacing, grid.direction
        values: NDArray[np.float32] = sitk.GetArrayFromImage(sitk.Resample(image, *placed, low))
        through = self.displacement or self.transform or self.moving
        return values, through if np.isfinite(moving.values).all() else self.moving


def joined(
    fixed: NDArray[np.float32],
    warped: NDArray[np.float32],
    inside: NDArray[np.bool_] | None,
    grid: Grid,
    blocks: tuple[int, int, int],
) -> LoadedPair:
    """Return block means of two volumes as a pair, with the mask of the whole volume reduced likewise."""
    if inside is not None and max(blocks) > 1:
        inside = block_means(inside, blocks) >= 0.5
    placed = grid if max(blocks) == 1 else None
    return LoadedPair(RegisteredPair(fixed, warped, spacing_of(grid, blocks), inside, placed), grid, blocks)


def usable(values: NDArray[np.float32], inside: NDArray[np.bool_] | None, name: Path | str) -> NDArray[np.float32]:
    """Return a volume finite outside the mask, too; InputError where it is not finite inside, or all equal."""
    if not all(np.isfinite(one_slice).all() for one_slice in values):  # a mask of the whole would take memory
        bad = ~np.isfinite(values)
        count = int(np.count_nonzero(bad if inside is None else bad & inside))
        if count:
            raise InputError(f"{name}: {count} voxels are no numbers; leave them out with a mask")
        values = np.where(bad, values[~bad].min(), values)
    if values.min() == values.max():
        raise InputError(f"{name}: all voxels are {values.flat[0]:g}; nothing to compare")
    return values


def label_masks(
    values: NDArray[np.float32], name: str, regions: Sequence[tuple[str, int]] = ()
) -> Iterator[tuple[str, NDArray[np.bool_]]]:
    """Yield name and mask, bool, of the regions of a mask or label map, one at a time.

    Of ``values``, 0 is outside. Whole numbers of which several occur are labels, as is one other than 1 and 255, or
    whatever occurs where ``regions`` names labels, (name, label); others are ``NAME_LABEL``. Fractions up to 1 are
    probabilities, of which the region has at least 0.5. InputError: fractions above 1, or of labels that have names:
    what a label map is after linear interpolation; or more labels than label maps have.
    """
    values = np.where(np.isfinite(values), values, np.float32(0))
    near = np.rint(values)
    whole = all(np.allclose(plane, near[z], rtol=0, atol=_LABEL_TOLERANCE) for z, plane in enumerate(values))
    if not whole:
        top = float(values.max())
        if regions or top > 1:
            raise InputError(f"values between whole numbers, up to {top:g}: resample labels by the nearest neighbor")
        yield name, values >= 0.5
        return
    present = sorted({float(label) for plane in near for label in np.unique(plane[plane > 0])})
    if present and (len(present) > _MAX_LABELS or present[-1] > _MAX_LABEL):
        raise InputError(f"{len(present)} values up to {present[-1]:g}: no label map, of at most {_MAX_LABELS} labels")
    names = {float(label): region for region, label in regions}
    if not names and present in ([], [1.0], [255.0]):
        yield name, near > 0
        return
    for label in sorted({*present, *names}):
        yield names.get(label, f"{name}_{label:.0f}"), near == label


def spacing_of(grid: Grid, blocks: tuple[int, int, int]) -> tuple[float, float, float]:
    """Return the distances (z, y, x) of the centers of blocks of voxels, mm."""
    z, y, x = (s * n for s, n in zip(grid.spacing[::-1], blocks, strict=True))
    return z, y, x


def blocks_of(grid: Grid, max_voxels: int | None) -> tuple[int, int, int]:
    """Voxels (z, y, x) that are taken together so that about ``max_voxels`` cubes are left."""
    count = grid.size[0] * grid.size[1] * grid.size[2]
    if max_voxels is None or count <= max_voxels:
        return (1, 1, 1)
    axes = [a for a in range(3) if grid.shape[a] > 1]
    spacing = grid.spacing[::-1]
    extent = math.prod(grid.shape[a] * spacing[a] for a in axes)
    side = float((extent / max_voxels) ** (1 / len(axes)))
    z, y, x = (max(1, int(side / spacing[a] + 1e-6)) if a in axes else 1 for a in range(3))
    return z, y, x
