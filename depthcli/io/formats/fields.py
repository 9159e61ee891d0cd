"""Transforms, displacement fields and landmarks of common registration programs, converted to mm along LPS.

======================  ==============================================================================
ITK, elastix            vector MHA, NRRD, NIfTI: displacement, mm, LPS; ``.tfm .txt .h5 .mat`` transforms;
                        ``TransformParameters.N.txt`` (translation, Euler, affine, B-spline, and chains)
ANTs                    ``1Warp.nii.gz`` (5-D, intent 1007): displacement, mm, LPS; ``0GenericAffine.mat``
NiftyReg                5-D, intent name NREG_TRANS, mm, RAS; intent_p1: 0 positions, 1 displacements, 2 and 6
                        control points of cubic and linear B-splines; velocities (3, 4, 5) are not supported
SPM                     5-D, ``y_*.nii``, intent name Mapping: positions, mm, RAS
Learn2Reg, VoxelMorph   ``.npz`` or 4-D NIfTI (X, Y, Z, 3): displacement, voxels
======================  ==============================================================================
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.resampling import nearest, trilinear
from depthcli.core.errors import InputError
from depthcli.core.volumes import Grid, Volume
from depthcli.io.formats.files import naming, open_regular, read_bytes, shown, warn
from depthcli.io.formats.plain_text import is_number, numbers, points_of, text_of
from depthcli.io.formats.volumes import (
    HEADER_BYTES,
    MAX_CHAIN,
    MAX_TRANSFORM_BYTES,
    initial_transform,
    itk_header,
    itk_image,
    library_errors,
    read_itk,
    read_volume,
    simple_itk,
    suffix_of,
)

READINGS = {
    "itk": "displacement in mm, LPS (ITK, elastix, ANTs)",
    "niftyreg": "displacement in mm, RAS (NiftyReg)",
    "positions": "positions in mm, RAS (SPM, NiftyReg deformation field)",
    "voxels": "displacement in voxels (Learn2Reg, VoxelMorph)",
}
"""Possible meanings of a field's numbers."""

_SPLINES = {"control points": 3, "linear control points": 1}  # further meaning -> order of the B-spline
_FRAME = re.compile(rb"^measurement frame:[ \t]*([^\r\n]*)", re.MULTILINE)  # in the header of NRRD
_VELOCITIES = ("positions of a velocity field", "velocities", "control points of velocities")
_NIFTYREG = ("positions", "niftyreg", "control points", *_VELOCITIES, "linear control points")  # by intent_p1

_MIN_RATIO = 1.1  # smallest ratio of mutual information at which another reading is clearly better
_MIN_GAIN = 0.02  # smallest gain of mutual information at which another reading is clearly better, nats
_MIN_FIT = 0.1  # mutual information below which two volumes have little in common, nats
_MAX_OUTSIDE = 0.1  # largest share of the fixed volume outside the field without a warning
_MIN_SHIFT = 0.1  # smallest plausible maximum displacement, voxels
_N_SAMPLES = 60_000  # voxels at which readings are compared
_N_INVERSIONS = 8  # fixed-point iterations; each at least halves the error for smooth fields
_N_BINS = 24  # histogram bins per volume


@dataclass(frozen=True)
class Field:
    """A field as stored."""

    values: NDArray[np.float32]  # (Z, Y, X, 3), components as in the file: x, y, z
    grid: Grid
    named: str  # key of READINGS or _SPLINES, from the header or the file's format


def read_field(path: Path, fixed: Grid) -> Field:
    """Return the field in a file, by its ending and header; files without a grid get the grid ``fixed``."""
    with naming(path):
        named = "itk"
        if suffix_of(path) == ".npz":
            return _in_voxels(_npz(path), fixed)
        if suffix_of(path) in (".nii", ".nii.gz"):
            header = itk_header(path)
            if header.GetDimension() == 4 and header.GetSize()[3] == 3:
                image, unknown = read_itk(path)
                values = simple_itk().GetArrayFromImage(image)
                if unknown is not None:
                    values[unknown.reshape(values.shape) != 0] = np.nan
                return _in_voxels(values.transpose(1, 2, 3, 0), fixed)
            named = _named_by_intent(header.GetMetaData("intent_name").strip(), header.GetMetaData("intent_p1"))
        elif suffix_of(path) in (".nrrd", ".nhdr"):
            with open_regular(path) as file:  # SimpleITK does not print the numbers of the frame
                found = _FRAME.search(file.read(HEADER_BYTES).partition(b"\n\n")[0])
            frame = found[1].decode("latin-1") if found else ""
            axes = [float(word) for word in re.findall(r"[^\s(),]+", frame) if is_number(word)]
            if frame and axes != [1, 0, 0, 0, 1, 0, 0, 0, 1]:
                raise InputError(
                    f"its vectors are in a measurement frame of their own ({frame[:100]}), which is not read"
                )
        volume = read_volume(path, vector=True)
        return Field(volume.values, volume.grid, named)


def _named_by_intent(name: str, parameter: str) -> str:
    """Return the reading that a NIfTI file's intent names. Raise InputError for velocities and unknown intents."""
    if name != "NREG_TRANS":
        return "positions" if name == "Mapping" else "itk"
    kind = float(parameter)
    if kind not in range(len(_NIFTYREG)):
        raise InputError(f"NiftyReg's intent_p1 = {kind:g} is not known; expected 0 to {len(_NIFTYREG) - 1}")
    if (named := _NIFTYREG[int(kind)]) in _VELOCITIES:
        raise InputError(
            f"NiftyReg's {named} (intent_p1 = {kind:g}), which must be integrated: reg_transform -disp writes the "
            "displacement"
        )
    return named


def _spline(field: Field) -> Any:
    """Return the B-spline transform for positions (mm, RAS) at control points."""
    shifts = in_millimeters(field, "positions")
    parts = [itk_image(np.ascontiguousarray(shifts[..., axis]), field.grid) for axis in range(3)]
    return simple_itk().BSplineTransform(parts, _SPLINES[field.named])


def _in_voxels(values: NDArray[Any], fixed: Grid) -> Field:
    """Return the field for (Z, Y, X, 3) displacements in voxels from a file without a grid."""
    if values.shape[:3] != fixed.shape:
        size, expected = " x ".join(map(str, values.shape[2::-1])), " x ".join(map(str, fixed.size))
        raise InputError(f"a field of {size} voxels, but the fixed volume has {expected}")
    with np.errstate(over="ignore", invalid="ignore"):
        return Field(np.ascontiguousarray(values, np.float32), fixed, "voxels")


def _npz(path: Path) -> NDArray[Any]:
    """Return the (Z, Y, X, 3) displacements in an .npz file. Raise InputError if it has not exactly one such array."""
    with open_regular(path) as file:
        try:
            with np.load(file, allow_pickle=False) as stored:
                arrays = {name: stored[name] for name in stored.files}
        except Exception:  # zipfile, zlib and numpy raise many kinds for damage, MemoryError among them
            raise InputError("not a readable .npz file") from None
    named = {name: each for name, each in arrays.items() if each.ndim == 4 and 3 in (each.shape[0], each.shape[3])}
    fields = list(named.values())
    if len(fields) != 1:
        raise InputError("expected one array (X, Y, Z, 3) or (3, X, Y, Z) of displacements")
    if others := [name for name in arrays if name not in named]:
        warn(f"{shown(path)}: its array {next(iter(named))!r} is read, not {', '.join(others)[:200]}")
    return np.transpose(fields[0], (2, 1, 0, 3) if fields[0].shape[3] == 3 else (3, 2, 1, 0))


def in_millimeters(field: Field, reading: str) -> NDArray[np.float64]:
    """Return the displacements of a field, (Z, Y, X, 3) mm, LPS; ``reading`` is a key of READINGS."""
    values: NDArray[np.float64] = field.values.astype(np.float64)
    if reading == "voxels":
        return np.asarray((values * np.array(field.grid.spacing)) @ field.grid.axes.T, np.float64)
    if reading != "itk":
        values *= np.array([-1.0, -1.0, 1.0])  # from RAS
    if reading == "positions":
        places = np.ascontiguousarray(np.indices(field.grid.shape, np.float64).reshape(3, -1).T)
        values -= field.grid.to_point(places).reshape(values.shape)
    return values


def read_moving_transform(
    transform: Path | None, displacement: Path | None, convention: str, fixed: Volume, moving: Volume | None
) -> Any:
    """Return the SimpleITK transform that maps a point of the fixed volume to the moving volume.

    With both files, the displacement is applied before the transform (ANTs: ``1Warp``, ``0GenericAffine``).
    ``convention`` is auto, itk, ants, niftyreg, positions or voxels; auto uses the header. If the moving volume is
    given, auto raises InputError if another reading fits clearly better. For any convention, and for transforms, warn
    if the inverse, negated or no displacements fit clearly better.
    """
    grids = fixed.grid, None if moving is None else moving.grid
    after = None if transform is None else read_transform(transform, grids)
    chain = [] if after is None else [after]
    if displacement is not None and suffix_of(displacement) in (".h5", ".tfm", ".txt"):
        chain.append(read_transform(displacement, grids))
    elif displacement is not None:
        chain.append(_displacement(displacement, convention, fixed, moving, after))
    assert chain
    combined = simple_itk().CompositeTransform(chain)
    if moving is not None:
        with naming(displacement or transform or ""):
            if reason := _misfit(combined, fixed, moving):
                warn(f"{shown(displacement or transform or '')}: {reason}")
    return combined


def _displacement(path: Path, convention: str, fixed: Volume, moving: Volume | None, after: Any) -> Any:
    """Return the SimpleITK transform of a displacement field, or of a B-spline of NiftyReg.

    ``after`` is the transform after it, or None. Raise InputError for unknown displacements, a convention that is not
    the field's, or a field that does not cover the fixed volume.
    """
    field = read_field(path, fixed.grid)
    if bad := int(np.count_nonzero(~np.isfinite(field.values).all(axis=3))):
        count = int(np.prod(field.grid.shape))
        raise InputError(f"{path}: {bad} of {count} displacements are no numbers; make them 0 where unknown")
    is_spline = field.named in _SPLINES
    if is_spline and convention not in ("auto", "niftyreg"):
        raise InputError(f"{path}: {field.named} of NiftyReg, which --field {convention} is not")
    reading = {"auto": field.named, "ants": "itk"}.get(convention, convention)
    if convention == "niftyreg" and field.named == "positions":
        reading = "positions"
    if convention == "auto" and moving is not None and not is_spline:
        with naming(path):
            _check_reading(field, reading, fixed, moving, after)
    shifts = in_millimeters(field, "positions" if is_spline else reading)
    with naming(path):
        if reason := _doubtful_extent(field.grid, shifts, fixed.grid):
            warn(f"{shown(path)}: {reason}")
    return _spline(field) if is_spline else simple_itk().DisplacementFieldTransform(itk_image(shifts, field.grid))


def _doubtful_extent(grid: Grid, shifts: NDArray[np.float64], fixed: Grid) -> str:
    """Return a warning if a field covers only a part of the fixed volume or is about 0, or an empty text.

    Raise InputError if it covers nothing of it.
    """
    axes = (np.arange(0.0, n, max(1, n // 32)) for n in fixed.shape)
    at = grid.to_index(fixed.to_point(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)))
    outside = float(np.mean(~np.all((at >= -0.5) & (at <= np.array(grid.shape) - 0.5), axis=1)))
    where = "where nothing is displaced; its origin and spacing must be in the frame of the fixed volume"
    if outside == 1:
        raise InputError(f"the whole fixed volume lies outside the field, {where}")
    if outside > _MAX_OUTSIDE:
        return f"{100 * outside:.0f} % of the fixed volume lies outside the field, {where}"
    largest = float(np.sqrt((shifts**2).sum(axis=-1).max()))
    if largest < _MIN_SHIFT * min(fixed.spacing):
        return f"the largest displacement is {largest:.2g} mm: is its unit mm, and is it the field of a registration?"
    return ""


def _check_reading(field: Field, named: str, fixed: Volume, moving: Volume, after: Any) -> None:
    """Raise InputError if the volumes fit clearly better with another reading of the field than the named one."""
    count = int(np.prod(field.grid.shape))
    chosen = np.arange(0, count, max(1, count // _N_SAMPLES))
    places = np.stack(np.unravel_index(chosen, field.grid.shape), axis=1).astype(np.float64)
    points = field.grid.to_point(places)
    at = fixed.grid.to_index(points)
    inside = np.all((at >= 0) & (at <= np.array(fixed.grid.shape) - 1), axis=1)
    if not inside.any():
        return
    target = nearest(fixed.values, at[inside])
    scores = {}
    for reading in READINGS:
        shift = in_millimeters(field, reading).reshape(-1, 3)[chosen[inside]]
        for way in (reading, "negated") if reading == named else (reading,):
            moved = points[inside] + (-shift if way == "negated" else shift)
            if after is not None:
                moved = np.array([after.TransformPoint(point) for point in moved.tolist()])
            scores[way] = _information(target, nearest(moving.values, moving.grid.to_index(moved)))
    still = _information(target, nearest(moving.values, moving.grid.to_index(points[inside])))
    best = max(scores, key=lambda reading: scores[reading])
    if best not in (named, "negated") and _clearly_better(scores[best], scores[named]):
        weak = scores[best] < _MIN_FIT or not _clearly_better(scores[best], still)
        raise InputError(
            f"its header says {READINGS[named]}, but read as {READINGS[best]} it fits the volumes clearly better "
            f"(mutual information {scores[best]:.2f} against {scores[named]:.2f}, {still:.2f} without it)"
            + ("; no reading fits well: does it belong to these volumes, and is its unit mm?" if weak else "")
            + f"; see --field {best}, or --field {named} to keep to the header"
        )


def _clearly_better(fit: float, other: float) -> bool:
    return fit > max(_MIN_RATIO * other, other + _MIN_GAIN)


def _misfit(transform: Any, fixed: Volume, moving: Volume) -> str:
    """Return a warning if inverse, negated or no displacements fit the volumes clearly better, or an empty text."""
    every = math.ceil((math.prod(fixed.grid.size) / _N_SAMPLES) ** (1 / 3))
    x, y, z = (-(-n // every) for n in fixed.grid.size)
    spacing = fixed.grid.spacing[0] * every, fixed.grid.spacing[1] * every, fixed.grid.spacing[2] * every
    grid = Grid((x, y, z), spacing, fixed.grid.origin, fixed.grid.direction)
    sitk = simple_itk()
    placed = grid.size, grid.origin, grid.spacing, grid.direction
    away = sitk.GetArrayFromImage(sitk.TransformToDisplacementField(transform, sitk.sitkVectorFloat32, *placed))
    points = grid.to_point(np.indices(grid.shape, np.float64).reshape(3, -1).T)
    own = away.reshape(-1, 3).astype(np.float64)
    back = -own
    for _ in range(_N_INVERSIONS):
        at = grid.to_index(points + back)
        back = -np.stack([trilinear(away[..., axis], at) for axis in range(3)], axis=1).astype(np.float64)
    target = fixed.values[::every, ::every, ::every].ravel()
    ways = {"": own, "inverted": back, "with its displacements negated": -own, "left out": 0 * own}
    warped = {way: nearest(moving.values, moving.grid.to_index(points + shift)) for way, shift in ways.items()}
    if np.isnan(warped[""]).all():
        raise InputError("it takes no point of the fixed volume into the moving volume; do the three belong together?")
    scores = {way: _information(target, values) for way, values in warped.items()}
    best = max(scores, key=lambda way: scores[way])
    if not best or not _clearly_better(scores[best], scores[""]):
        return ""
    left_out = "does it belong to these volumes?"
    return (
        f"{best} it fits the volumes clearly better (mutual information {scores[best]:.2f} against {scores['']:.2f}); "
        + (left_out if best == "left out" else "it must lead from the fixed to the moving volume")
    )


def _information(one: NDArray[np.float32], other: NDArray[np.float32]) -> float:
    """Return the mutual information, nats; points outside the moving volume (NaN) have their own bin."""
    low, high = (float(np.nanmin(other)), float(np.nanmax(other))) if np.isfinite(other).any() else (0.0, 1.0)
    second = np.where(np.isnan(other), 0, (other - low) / max(high - low, 1e-12) * (_N_BINS - 2) + 1).astype(np.int64)
    span = max(float(one.max() - one.min()), 1e-12)
    first = np.clip((one - one.min()) / span * _N_BINS, 0, _N_BINS - 1).astype(np.int64)
    cells = first * _N_BINS + np.clip(second, 0, _N_BINS - 1)
    p = np.bincount(cells, minlength=_N_BINS**2).reshape(_N_BINS, _N_BINS) / len(cells)
    known, independent = p > 0, p.sum(axis=1, keepdims=True) * p.sum(axis=0, keepdims=True)
    return max(0.0, float(np.sum(p[known] * np.log(p[known] / independent[known]))))  # not -0.00


def read_transform(path: Path, grids: tuple[Grid, Grid | None] | None = None) -> Any:
    """Return the SimpleITK transform in an ITK file or a chain of elastix parameter files.

    ``grids`` are the grids of the fixed and, if known, the moving volume; they give the directions if elastix left
    them out.
    """
    sitk = simple_itk()
    with naming(path):
        if suffix_of(path) == ".txt":
            text = text_of(read_bytes(path, MAX_TRANSFORM_BYTES))
            if "(Transform " in text:
                with library_errors():
                    chain = sitk.CompositeTransform(_elastix_chain(path, text, ()))
                    return (
                        chain if _elastix_fields(text)["UseDirectionCosines"] == ["true"] else _undirected(chain, grids)
                    )
        with open_regular(path), library_errors():
            return sitk.ReadTransform(str(path))


def _elastix_fields(text: str) -> dict[str, list[str]]:
    fields = {"UseDirectionCosines": ["true"]}
    for name, words in re.findall(r"^\s*\((\w+)\s+(.*?)\)\s*(?://.*)?$", text, re.MULTILINE):
        fields[name] = [part.strip('"') for part in re.findall(r'"[^"]*"|\S+', words)] or [""]
    return fields


def _undirected(chain: Any, grids: tuple[Grid, Grid | None] | None) -> Any:
    """Return the transform between volumes with directions for one between volumes without them."""
    fixed, moving = grids or (None, None)
    if fixed is None or (moving is None and not np.array_equal(fixed.axes, np.eye(3))):
        raise InputError(
            'its "UseDirectionCosines" is "false"; with the directions of both volumes only it can be read'
        )
    sitk, placed = simple_itk(), fixed if moving is None else moving
    before = sitk.AffineTransform(fixed.axes.T.ravel().tolist(), (0.0, 0.0, 0.0), fixed.origin)
    after = sitk.AffineTransform(placed.axes.ravel().tolist(), (0.0, 0.0, 0.0), placed.origin)
    return sitk.CompositeTransform([after, chain, before])


def _elastix_chain(path: Path, text: str, before: tuple[Path, ...]) -> list[Any]:
    """Return this file's transform, followed by its initial transforms; SimpleITK applies the last one first."""
    fields = _elastix_fields(text)
    if path.resolve() in before or len(before) > MAX_CHAIN:
        raise InputError("its chain of initial transforms comes back to it")
    if fields.get("HowToCombineTransforms", ["Compose"])[0] != "Compose":
        raise InputError("transforms that are added, not composed, are not read")
    for key in ("UseCyclicTransform", "UseBinaryFormatForTransformationParameters"):
        if fields.get(key, ["false"])[0] != "false":
            raise InputError(f"{key} {fields[key][0]!r} is not read; write the field with transformix -def all")
    own = _elastix_transform(fields)
    file = initial_transform(path, text)
    if file is None:
        return [own]
    with naming(file):
        below = text_of(read_bytes(file, MAX_TRANSFORM_BYTES))
    return [own, *_elastix_chain(file, below, (*before, path.resolve()))]


def _elastix_transform(fields: dict[str, list[str]]) -> Any:
    """Return the transform of one elastix parameter file, as SimpleITK's. Raise InputError for other kinds."""
    sitk = simple_itk()
    name = fields.get("Transform", [""])[0]

    def values(key: str, count: int, default: list[float] | None = None) -> list[float]:
        found: list[float] = numbers(fields.get(key, default), key, (count,)).tolist()
        return found

    if values("FixedImageDimension", 1, [3.0]) != [3.0]:
        raise InputError("not a transform of three dimensions")
    if name == "TranslationTransform":
        return sitk.TranslationTransform(3, values("TransformParameters", 3))
    if name == "AffineTransform":
        parameters = values("TransformParameters", 12)
        return sitk.AffineTransform(parameters[:9], parameters[9:], values("CenterOfRotationPoint", 3))
    if name == "EulerTransform":
        transform = sitk.Euler3DTransform()
        transform.SetComputeZYX(fields.get("ComputeZYX", ["false"])[0] == "true")
        transform.SetCenter(values("CenterOfRotationPoint", 3))
        transform.SetParameters(values("TransformParameters", 6))
        return transform
    if name not in ("BSplineTransform", "RecursiveBSplineTransform"):
        raise InputError(f"a {name} is not read; write the field with transformix -def all")
    x, y, z = (int(n) for n in values("GridSize", 3))
    order = values("BSplineTransformSplineOrder", 1, [3.0])[0]
    # elastix writes the direction column by column.
    axes = np.array(values("GridDirection", 9, [1, 0, 0, 0, 1, 0, 0, 0, 1])).reshape(3, 3).T
    spacing, index = np.array(values("GridSpacing", 3)), np.array(values("GridIndex", 3, [0.0, 0.0, 0.0]))
    if order not in (1, 2, 3) or min(x, y, z) < 1 or min(spacing) <= 0:
        raise InputError(
            f"B-splines of order {order:g} on {x} x {y} x {z} points {spacing} mm apart; expected order 1 to 3"
        )
    origin = np.array(values("GridOrigin", 3)) + axes @ (spacing * index)
    grid = Grid((x, y, z), tuple(spacing), tuple(origin), tuple(axes.ravel()))
    coefficients = np.array(values("TransformParameters", 3 * x * y * z)).reshape(3, *grid.shape)
    return sitk.BSplineTransform([itk_image(component, grid) for component in coefficients], int(order))


def read_landmarks(path: Path, grid: Grid, raw: bool = False) -> NDArray[np.float64]:
    """Return (N, 3) positions x, y, z in mm, LPS, from a list of points or of voxels of ``grid``.

    Text files for a DIR-Lab ``raw`` volume have voxels, counted from 1.
    """
    with naming(path):
        lines = [line.strip() for line in text_of(read_bytes(path, 1 << 26)).splitlines() if line.strip()]
        if lines and lines[0].lower() in ("point", "index"):
            points = points_of(lines[2:])
            return grid.to_point(points[:, ::-1]) if lines[0].lower() == "index" else points
        comments = [line.lstrip("# ") for line in lines if line.startswith("#")]
        head = dict(re.findall(r"^([^=]*?)\s*=\s*(.*)$", "\n".join(comments), re.MULTILINE))  # as in 3D Slicer's .fcsv
        heads = [head["columns"]] if "columns" in head else [text for text in comments if "=" not in text]
        points = points_of([line for line in lines if not line.startswith("#")], heads)
        if raw and suffix_of(path) == ".txt":
            return grid.to_point(points[:, ::-1] - 1)
        return points * [-1, -1, 1] if head.get("CoordinateSystem") in ("RAS", "0") else points
