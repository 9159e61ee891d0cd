"""Registered pairs of volumes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from depthcli.core.errors import ConfigError, InputError
from depthcli.io.registered_volumes import blocks_of, joined, label_masks, spacing_of, usable
from depthcli.io.scenes import Scene, name_of

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from depthcli.core.volumes import Grid, Volume
    from depthcli.io.registered_volumes import LoadedPair

_GENERIC_NAMES = ("fixed", "fixed.nii")
LEFT_OUT = {"displacement": "transform", "transform": "displacement", "both": ""}
"""What counts of a displacement field and a transform -> what does not; both: the field first, as ANTs chains them."""


@dataclass(frozen=True)
class RegistrationTruth:
    """True errors of a registration.

    Attributes
    ----------
    grid : the fixed volume's
    points : (N, 3) landmarks of the fixed volume, x, y, z in mm; empty where the truth is dense
    error : (N,) mm at the landmarks, or (Z, Y, X) mm, NaN = unknown
    """

    grid: Grid
    points: NDArray[np.float64]
    error: NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class VolumePairScene(Scene):
    """The files of one pair.

    Attributes
    ----------
    fixed : fixed volume
    moving_warped : the moving volume after registration, on the fixed grid; or None
    moving : the moving volume, for which ``transform`` or ``displacement`` (or both) map fixed points; or None
    transform, displacement : see ``data/formats/fields.py``
    mask : where the fixed volume is of interest (not 0), or None
    regions : (name, file) of masks and label maps of the fixed volume, whose errors are reported apart
    labels : of label maps, (name of the map, ((name of a region, its label), ...))
    landmarks_fixed, landmarks_moving : corresponding points, or None
    error_true : dense true error, mm, or None
    """

    fixed: Path
    moving_warped: Path | None = None
    moving: Path | None = None
    transform: Path | None = None
    displacement: Path | None = None
    mask: Path | None = None
    regions: tuple[tuple[str, Path], ...] = ()
    labels: tuple[tuple[str, tuple[tuple[str, int], ...]], ...] = ()
    landmarks_fixed: Path | None = None
    landmarks_moving: Path | None = None
    error_true: Path | None = None

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
        from depthcli.io.formats import fields, volumes

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
        """Return both volumes on the fixed grid, and the mask.

        Parameters
        ----------
        convention : of the displacement file
        max_voxels : where there are more voxels than this, means of blocks of them, so that two whole volumes are
            never in memory; blocks are no larger than the cubes that so many voxels of the volume would be

        Raises
        ------
        InputError
            Files that cannot be used, grids that differ, values that are no numbers inside the mask.
        """
        from depthcli.algorithms.resampling import block_means
        from depthcli.io.formats.volumes import read_volume

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
        """Yield the regions of one of the masks: its own name, or one for each label where there are several.

        Parameters
        ----------
        name : of the mask, as in ``regions``
        grid : the fixed volume's

        Yields
        ------
        Name, and mask (Z, Y, X) bool; a label without a name in ``labels`` is ``NAME_LABEL``

        Raises
        ------
        InputError
            The file cannot be used, or has another grid.
        """
        from depthcli.io.formats.files import naming

        file = dict(self.regions)[name]
        values = self._read_like(file, grid)
        with naming(file):
            yield from label_masks(values, name, dict(self.labels).get(name, ()))

    def size(self, max_voxels: int | None = None) -> tuple[Grid, tuple[int, int, int], tuple[float, float, float]]:
        """Return the fixed volume's grid, and shape and spacing (z, y, x) of what :meth:`load` gives, by its header."""
        from depthcli.io.formats.volumes import read_grid

        self.check()
        grid = read_grid(self.fixed)
        blocks = blocks_of(grid, max_voxels)
        z, y, x = (-(-n // b) for n, b in zip(grid.shape, blocks, strict=True))
        return grid, (z, y, x), spacing_of(grid, blocks)

    def truth(self, convention: str = "auto") -> RegistrationTruth:
        """Return the true errors: dense where there is such a file, or at the landmarks |T(p) - q|.

        Raises
        ------
        InputError
            There is none, the lists differ in length, or a landmark lies outside the fixed volume.
        """
        import numpy as np

        from depthcli.io.formats.fields import read_landmarks, read_moving_transform
        from depthcli.io.formats.volumes import read_volume

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
        import numpy as np

        from depthcli.io.formats.fields import read_landmarks

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
        from depthcli.io.formats.volumes import read_volume

        volume = read_volume(file)
        if not volume.grid.same_as(fixed):
            raise InputError(f"{file}: another grid than the fixed volume's ({volume.grid.describe_difference(fixed)})")
        return volume.values

    def _warp(self, fixed: Volume, convention: str) -> tuple[NDArray[np.float32], Path]:
        """The moving volume on the fixed grid, and the file that is to blame where it holds what is no number."""
        import numpy as np

        from depthcli.io.formats.fields import read_moving_transform
        from depthcli.io.formats.volumes import place, read_volume, simple_itk

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
