"""Load registered pairs of volumes and their true errors from the files of a scene."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.resampling import block_means
from depthcli.core.errors import InputError
from depthcli.core.volumes import Grid, RegisteredPair, Volume
from depthcli.io.formats.fields import read_landmarks, read_moving_transform
from depthcli.io.formats.files import naming, warn
from depthcli.io.formats.volumes import is_raw, itk_image, read_grid, read_volume, simple_itk
from depthcli.io.scenes import VolumePairScene

_LABEL_TOLERANCE = 1e-3  # largest rounding error of a label
_MAX_LABELS = 2000  # more distinct values are gray values of a scan; atlases have some hundred labels
# Largest mean distance of landmark pairs, divided by the mean distance of random pairs; registered pairs have 0.05 to
# 0.4.
_MAX_PAIRING = 0.7
_MAX_LABEL = 1 << 24  # whole numbers up to here are exact in float32


@dataclass(frozen=True)
class LoadedPair:
    """A registered pair in memory."""

    pair: RegisteredPair
    grid: Grid  # the fixed volume's
    blocks: tuple[int, int, int] = (1, 1, 1)  # size (z, y, x) of the block whose mean is a voxel of ``pair``

    def on_grid(self, start: Sequence[float], step: Sequence[float]) -> tuple[list[float], list[float]]:
        """Convert ``start`` and ``step`` of maps from voxels of ``pair`` to voxels of the fixed volume."""
        begin = [(n - 1) / 2 + n * a for n, a in zip(self.blocks, start, strict=True)]
        return begin, [n * a for n, a in zip(self.blocks, step, strict=True)]


@dataclass(frozen=True)
class RegistrationTruth:
    """True errors of a registration."""

    grid: Grid  # the fixed volume's
    points: NDArray[np.float64]  # (N, 3) landmarks of the fixed volume, x, y, z in mm; empty for dense errors
    error: NDArray[np.float32]  # (N,) mm at the landmarks, or (Z, Y, X) mm, NaN = unknown


def load_volumes(scene: VolumePairScene, convention: str = "auto", max_voxels: int | None = None) -> LoadedPair:
    """Return both volumes on the fixed grid, and the mask; ``convention`` is the displacement file's.

    Volumes of more than ``max_voxels`` voxels are reduced to block means, so that two whole volumes are never in
    memory. Blocks are no larger than the cubes that would divide the volume into ``max_voxels`` parts.
    """
    scene.check()
    fixed = read_volume(scene.fixed)
    grid = fixed.grid
    blocks = blocks_of(grid, max_voxels)
    inside = None if scene.mask is None else _read_mask(scene.mask, grid)
    if inside is not None and not inside.any():
        raise InputError(f"{scene.mask}: no voxel is set")
    first = block_means(usable(fixed.values, inside, scene.fixed), blocks)
    if scene.moving_warped is not None:
        del fixed
        moved, source = _read_like(scene.moving_warped, grid), scene.moving_warped
    else:
        assert scene.moving is not None  # otherwise the scene has a problem
        moved, source = _warped(scene, scene.moving, fixed, convention)
        del fixed
    moved = usable(moved, inside, source)
    if np.isin(moved, (moved.min(), moved.max())).all():
        warn(f"{source}: only the values {moved.min():g} and {moved.max():g}: is it a mask, not the moving volume?")
    second = block_means(moved, blocks)
    return joined(first, second, inside, grid, blocks)


def loaded_size(
    scene: VolumePairScene, max_voxels: int | None = None
) -> tuple[Grid, tuple[int, int, int], tuple[float, float, float]]:
    """Return the fixed volume's grid, and shape and spacing (z, y, x) of the loaded volume, from its header."""
    scene.check()
    grid = read_grid(scene.fixed)
    blocks = blocks_of(grid, max_voxels)
    z, y, x = (-(-n // b) for n, b in zip(grid.shape, blocks, strict=True))
    return grid, (z, y, x), spacing_of(grid, blocks)


def region_masks(scene: VolumePairScene, name: str, grid: Grid) -> Iterator[tuple[str, NDArray[np.bool_]]]:
    """Yield name and mask (Z, Y, X) bool of each region in a file of ``scene.regions``; see :func:`label_masks`."""
    file = dict(scene.regions)[name]
    values = _read_like(file, grid)
    with naming(file):
        yield from label_masks(values, name, dict(scene.labels).get(name, ()))


def true_errors(scene: VolumePairScene, convention: str = "auto") -> RegistrationTruth:
    """Return the true errors: dense if there is such a file, otherwise |T(p) - q| at the landmarks."""
    scene.check()
    if not scene.has_truth:
        raise InputError(
            f"{scene.folder}: {scene.name} has no true errors (error_true.*, or landmarks of both with the transform)"
        )
    fixed = read_volume(scene.fixed)
    if scene.error_true is not None:
        error = _read_like(scene.error_true, fixed.grid)
        if (error < 0).any():
            share = 100 * np.mean(error < 0)
            warn(f"{scene.error_true}: {share:.3g} % of the voxels are negative: taken as unknown errors")
            error = np.where(error < 0, np.float32(np.nan), error)
        if scene.mask is not None:
            error = np.where(_read_like(scene.mask, fixed.grid) > 0, error, np.float32(np.nan))
        return RegistrationTruth(fixed.grid, np.zeros((0, 3)), error)
    points = landmarks(scene, fixed.grid)
    assert points is not None and scene.landmarks_moving is not None
    moving = None if scene.moving is None else read_volume(scene.moving)
    raw = scene.moving is not None and is_raw(scene.moving)
    matches = read_landmarks(scene.landmarks_moving, fixed.grid if moving is None else moving.grid, raw)
    if len(points) != len(matches):
        raise InputError(f"{scene.landmarks_moving}: {len(matches)} landmarks, but {len(points)} of the fixed one")
    transform = read_moving_transform(scene.transform, scene.displacement, convention, fixed, moving)
    moved, back = (np.array([transform.TransformPoint(p) for p in some.tolist()]) for some in (points, matches))
    text = "" if moving is None else _outside(matches, moving.grid, "moving")
    if text := text or _unpaired(points, matches, moved, back):
        warn(f"{scene.landmarks_moving}: {text}")
    return RegistrationTruth(fixed.grid, points, np.linalg.norm(moved - matches, axis=1).astype(np.float32))


def _unpaired(
    points: NDArray[np.float64], matches: NDArray[np.float64], moved: NDArray[np.float64], back: NDArray[np.float64]
) -> str:
    """Return a line if landmarks (N, 3), mm, and their ``matches`` seem not to correspond, or an empty text.

    ``moved`` and ``back`` are ``points`` and ``matches``, each mapped by the transform.
    """
    error, before, exchanged = (
        float(np.linalg.norm(one - other, axis=1).mean())
        for one, other in ((moved, matches), (points, matches), (back, points))
    )
    if exchanged < error / 2 and error > before:
        return f"exchanged with those of the fixed volume they fit ({exchanged:.1f} mm apart, not {error:.1f} mm)"
    random = float(np.mean([np.linalg.norm(moved - match, axis=1).mean() for match in matches]))
    if len(points) > 2 and error > _MAX_PAIRING * random:
        return (
            f"{error:.1f} mm from those of the fixed volume, random pairs {random:.1f} mm: are they of the same "
            "patient, in the same order, and in mm?"
        )
    if error > before:
        return f"the registration takes the landmarks apart: {error:.1f} mm, without it {before:.1f} mm"
    return ""


def landmarks(scene: VolumePairScene, grid: Grid) -> NDArray[np.float64] | None:
    """Return (N, 3) landmarks of the fixed volume, mm, or None."""
    if scene.landmarks_fixed is None:
        return None
    points = read_landmarks(scene.landmarks_fixed, grid, is_raw(scene.fixed))
    if text := _outside(points, grid, "fixed"):
        raise InputError(f"{scene.landmarks_fixed}: {text}")
    whole = len(points) > 3 and np.array_equal(points, np.rint(points))
    if whole and not np.allclose(index := grid.to_index(points), np.rint(index), rtol=0, atol=0.01):
        warn(f"{scene.landmarks_fixed}: only whole numbers, which are no centers of voxels: are they voxels, not mm?")
    return points


def _outside(points: NDArray[np.float64], grid: Grid, name: str) -> str:
    """Return a line about the landmarks (N, 3), mm, LPS, outside the volume ``name``, or an empty text."""
    outside, turned, counted = (
        ~np.all((places >= -0.5) & (places <= np.array(grid.shape) - 0.5), axis=1)
        for places in (grid.to_index(points), grid.to_index(points * [-1, -1, 1]), points[:, ::-1])
    )
    if not outside.any():
        return ""
    hint = "" if counted.any() else "; as voxels they fit: positions must be in mm"
    hint = hint if turned.any() else "; with x and y negated they fit: positions must be LPS, not RAS"
    first = int(np.flatnonzero(outside)[0]) + 1
    count = f"{int(outside.sum())} of {len(points)} landmarks lie outside the {name} volume"
    return f"{count}, the first is point {first}{hint}"


def _read_like(file: Path, fixed: Grid) -> NDArray[np.float32]:
    """Return the values of a volume. Raise InputError if it is not on the fixed grid."""
    volume = read_volume(file)
    if not volume.grid.same_as(fixed):
        raise InputError(f"{file}: another grid than the fixed volume's ({volume.grid.describe_difference(fixed)})")
    return volume.values


def _read_mask(file: Path, fixed: Grid) -> NDArray[np.bool_]:
    """Return whether each voxel of a mask is above 0; warn if the values look like a scan."""
    values = _read_like(file, fixed)
    low, high = float(values.min()), float(values.max())
    if low < 0 or (high > 1 and not np.array_equal(values, np.rint(values))):
        warn(f"{file}: values from {low:g} to {high:g}: is it a mask? Voxels above 0 count as inside")
    return values > 0


def _warped(scene: VolumePairScene, file: Path, fixed: Volume, convention: str) -> tuple[NDArray[np.float32], Path]:
    """Return the moving volume on the fixed grid, and the file that causes values that are not finite."""
    sitk, moving, grid = simple_itk(), read_volume(file), fixed.grid
    transform = read_moving_transform(scene.transform, scene.displacement, convention, fixed, moving)
    image = itk_image(moving.values, moving.grid)
    placed = grid.size, transform, sitk.sitkLinear, grid.origin, grid.spacing, grid.direction
    values: NDArray[np.float32] = sitk.GetArrayFromImage(sitk.Resample(image, *placed, float(moving.values.min())))
    through = scene.displacement or scene.transform or file
    return values, through if np.isfinite(moving.values).all() else file


def joined(
    fixed: NDArray[np.float32],
    warped: NDArray[np.float32],
    inside: NDArray[np.bool_] | None,
    grid: Grid,
    blocks: tuple[int, int, int],
) -> LoadedPair:
    """Return block means of two volumes as a pair; the full-size mask ``inside`` is reduced here."""
    if inside is not None and max(blocks) > 1:
        inside = block_means(inside, blocks) >= 0.5
    placed = grid if max(blocks) == 1 else None
    return LoadedPair(RegisteredPair(fixed, warped, spacing_of(grid, blocks), inside, placed), grid, blocks)


def usable(values: NDArray[np.float32], inside: NDArray[np.bool_] | None, name: Path | str) -> NDArray[np.float32]:
    """Return a volume with finite values outside the mask, too.

    Raise InputError if values inside are not finite, or all values are equal.
    """
    if not all(np.isfinite(one_slice).all() for one_slice in values):  # slice by slice to save memory
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
    """Yield name and mask, bool, of each region in a mask or label map.

    0 is outside. A map with one value, 1 or 255, is a mask, unless ``regions``, (name, label), is given. Other whole
    numbers are labels; labels without a name are called ``NAME_LABEL``. Fractions up to 1 are probabilities, and the
    region has the voxels with at least 0.5.

    Raise InputError for fractions above 1 or with named labels, as linear interpolation of labels makes them, and for
    more labels than label maps have.
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
    """Return the spacing (z, y, x) of blocks of voxels, mm."""
    z, y, x = (s * n for s, n in zip(grid.spacing[::-1], blocks, strict=True))
    return z, y, x


def blocks_of(grid: Grid, max_voxels: int | None) -> tuple[int, int, int]:
    """Return the block size (z, y, x), in voxels, that leaves about ``max_voxels`` blocks, nearly cubes."""
    count = grid.size[0] * grid.size[1] * grid.size[2]
    if max_voxels is None or count <= max_voxels:
        return (1, 1, 1)
    axes = [a for a in range(3) if grid.shape[a] > 1]
    spacing = grid.spacing[::-1]
    extent = math.prod(grid.shape[a] * spacing[a] for a in axes)
    side = float((extent / max_voxels) ** (1 / len(axes)))
    z, y, x = (max(1, int(side / spacing[a] + 1e-6)) if a in axes else 1 for a in range(3))
    return z, y, x
