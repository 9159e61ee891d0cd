"""Volumes as files: NIfTI, MetaImage, NRRD, DIR-Lab raw, DICOM series; two-dimensional images as one slice.

SimpleITK reads them; only this module imports this extra (``pip install depthcli[medical]``). Volumes are written
without it, slab by slab, so that a volume may be larger than the memory and its bytes are reproducible.
"""

from __future__ import annotations

import contextlib
import gzip
import math
import os
import re
import struct
import warnings
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.core.volumes import Grid, Volume
from depthcli.io.formats.files import atomic_path, naming, open_regular, read_bytes, shown, silent
from depthcli.io.formats.images import IMAGE_SUFFIXES, image_size, read_grey
from depthcli.io.formats.plain_text import json_object, numbers, text_of

VOLUME_SUFFIXES = (".nii", ".nii.gz", ".mha", ".mhd", ".nrrd", ".nhdr", ".img")
"""Endings of volume files; ``.img`` is NIfTI with a separate header, or DIR-Lab's raw format with ``meta.json``."""

MAX_TRANSFORM_BYTES = 1 << 30
"""Largest size of a transform file; B-spline parameters as text may be long."""

HEADER_BYTES = 1 << 20
"""Start of a MetaImage or NRRD file, which contains its header."""

MAX_CHAIN = 100
"""Largest number of chained elastix transforms; a registration has two or three."""


_NIFTI = (".nii", ".nii.gz", ".hdr", ".img")
_ITK_READERS = dict.fromkeys(_NIFTI, "NiftiImageIO") | dict.fromkeys((".mha", ".mhd"), "MetaImageIO")
_ITK_READERS |= dict.fromkeys((".nrrd", ".nhdr"), "NrrdImageIO")
_MAX_SIDE = 1 << 20  # voxels; no volume is as wide
_MAX_SPACING = 1e12  # mm; the smallest is 1e-12; float32 can represent the squares of both
_NIFTI_FLOATS = {"16": "f4", "64": "f8"}  # the header's datatype -> dtype
_SLICE_POSITION = "0020|0032"  # DICOM's Image Position (Patient)
_MAX_UNEVENNESS = 0.05  # largest relative difference of slice distances; a missing slice doubles one of them
_DATA_FILE = re.compile(rb"^(?:ElementDataFile\s*[=:]|data ?file:)[ \t]*([^\r\n]+)\r?\n?((?:[^\r\n]+\r?\n?)*)", re.M)
_INITIAL = re.compile(r'^\s*\(InitialTransformParameters?FileName\s+("[^"\n]*"|[^\s)]+)', re.MULTILINE)
_MAX_LINE = 250  # characters per line in a MetaImage header; the library copies longer lines unchecked

Slab = Callable[[int, int], NDArray[Any]]
"""(first, last) -> slices ``first`` up to ``last`` of a volume (n, Y, X) or vector field (n, Y, X, 3)."""


def suffix_of(path: Path) -> str:
    """Return the ending of a file, with both parts of ``.nii.gz``."""
    return ".nii.gz" if path.name.lower().endswith(".nii.gz") else path.suffix.lower()


def simple_itk() -> Any:
    """Return the module SimpleITK. If it is missing, raise InputError with install instructions."""
    try:
        with warnings.catch_warnings():
            # SWIG's types lack a __module__ attribute, which Python 3.12 and newer deprecate.
            warnings.simplefilter("ignore", DeprecationWarning)
            import SimpleITK
    except ImportError:
        raise InputError("medical volumes need SimpleITK: pip install 'depthcli[medical]'") from None
    SimpleITK.ProcessObject.SetGlobalWarningDisplay(False)
    return SimpleITK


def nifti_header(path: Path) -> bytes:
    """Return the NIfTI header (``.hdr``) of a volume's values (``.img``), or empty bytes.

    Raise InputError for an Analyze 7.5 header without ``meta.json``, since it has no directions.
    """
    header = path.with_suffix(".hdr")
    if not header.is_file():
        return b""
    data = read_bytes(header)
    if data[344:347] == b"ni1":
        return data
    if path.with_name("meta.json").is_file():
        return b""
    raise InputError(f"{header}: a header of Analyze 7.5, which has no directions; convert it to NIfTI")


def is_raw(path: Path) -> bool:
    """Return whether a file is in DIR-Lab's raw format: ``.img`` without a NIfTI header."""
    return suffix_of(path) == ".img" and not nifti_header(path)


def read_volume(path: Path, vector: bool = False, infinite: bool = False) -> Volume:
    """Return a volume, or a field of three components if ``vector``. Infinite numbers in NIfTI files become NaN.

    If ``infinite``, they are kept.
    """
    with naming(path):
        if suffix_of(path) in IMAGE_SUFFIXES:
            plane = read_grey(path)
            return Volume(plane.astype(np.float32)[None], Grid((plane.shape[1], plane.shape[0], 1), (1.0, 1.0, 1.0)))
        if is_raw(path):
            return _dirlab(path)
        image, unknown = read_itk(path)
        size, dimension, parts = image.GetSize(), image.GetDimension(), image.GetNumberOfComponentsPerPixel()
        if dimension == 4 and size[3] == 1:
            image, dimension = simple_itk().Extract(image, [*size[:3], 0], [0, 0, 0, 0]), 3
        elif dimension == 2:
            image = simple_itk().JoinSeries(image)
        if dimension not in (2, 3) or not math.prod(size):
            raise InputError(f"{dimension}-D ({' x '.join(map(str, size))}), expected a single volume")
        if parts != (wanted := 3 if vector else 1):
            raise InputError(f"{parts} values a voxel, expected {wanted}")
        spacing = _checked(image.GetSpacing())
        grid = Grid(tuple(image.GetSize()), spacing, tuple(image.GetOrigin()), tuple(image.GetDirection()))
        with np.errstate(over="ignore"):  # values beyond float32 become infinite
            values = np.array(simple_itk().GetArrayViewFromImage(image), np.float32, order="C")
        # NIfTI stores a field's components one after another.
        in_order = np.moveaxis(values, -1, 0) if vector else values
        if unknown is not None:
            marks = unknown.reshape(in_order.shape)
            in_order[marks != 0] = marks[marks != 0] if infinite else np.nan
        return Volume(values, grid)


def _checked(spacing: Any) -> Any:
    if not all(1 / _MAX_SPACING <= s <= _MAX_SPACING for s in spacing):
        raise InputError(f"a spacing of {spacing}")
    return spacing


def read_grid(path: Path) -> Grid:
    """Return a volume's size and spacing as a grid from the header alone; origin and direction may be missing.

    Raise InputError as :func:`read_volume` does.
    """
    if os.path.isdir(path):
        return read_volume(path).grid
    with naming(path):
        if suffix_of(path) in IMAGE_SUFFIXES:
            height, width = image_size(path)
            return Grid((width, height, 1), (1.0, 1.0, 1.0))
        if is_raw(path):
            return _dirlab_grid(path)
        reader = itk_header(path)
        size, spacing = (*reader.GetSize()[:3], 1)[:3], (*reader.GetSpacing()[:3], 1.0)[:3]
        if not 2 <= reader.GetDimension() <= 4:
            raise InputError(f"{reader.GetDimension()}-D, expected a single volume")
        return Grid(size, _checked(spacing))


def read_itk(path: Path) -> tuple[Any, NDArray[np.float32] | None]:
    """Return the SimpleITK image of a file, and the non-finite numbers of a NIfTI file, which ITK reads as 0.

    They are in a flat array in the file's order, 0 for finite numbers, or None if all are finite.
    """
    if os.path.isdir(path):
        return _dicom(path), None
    reader = itk_header(path)
    unknown = _unknown_in_nifti(path, reader) if suffix_of(path) in _NIFTI else None
    with library_errors():
        return reader.Execute(), unknown


def _dicom(folder: Path) -> Any:
    """Return the SimpleITK image of the only DICOM series in a folder; its slices must be evenly spaced."""
    reader = simple_itk().ImageSeriesReader()
    with library_errors():
        series = reader.GetGDCMSeriesIDs(str(folder))
        if len(series) != 1:
            raise InputError(f"a folder with {len(series)} DICOM series, expected one")
        files = reader.GetGDCMSeriesFileNames(str(folder), series[0])
        for file in files:
            _check_single_frame(Path(file))
        reader.SetFileNames(files)
        reader.MetaDataDictionaryArrayUpdateOn()
        image = reader.Execute()
        if len(files) > 1 and not reader.HasMetaDataKey(0, _SLICE_POSITION):
            raise InputError("its DICOM slices have no position (0020,0032); convert them to NIfTI or MetaImage")
        places = [
            reader.GetMetaData(k, _SLICE_POSITION).split("\\") for k in range(len(files) if len(files) > 1 else 0)
        ]
    steps = np.linalg.norm(np.diff(np.array(places, np.float64).reshape(-1, 3), axis=0), axis=1)
    if steps.size and not steps.max():
        raise InputError(f"all its {len(files)} DICOM slices are at one place: a series over time? expected a volume")
    if steps.size and steps.min() <= _MAX_UNEVENNESS * np.median(steps):
        k = int(np.argmin(steps))
        one, other = (Path(files[n]).name for n in (k, k + 1))
        raise InputError(f"its DICOM slices {one} and {other} are at one place: is one a duplicate? take it out")
    if steps.size and np.ptp(steps) > _MAX_UNEVENNESS * steps.max():
        raise InputError(f"its DICOM slices are {steps.min():.4g} to {steps.max():.4g} mm apart: is one missing?")
    return image


def _check_single_frame(file: Path) -> None:
    """Raise InputError if a DICOM file has several frames."""
    header = simple_itk().ImageFileReader()
    header.SetImageIO("GDCMImageIO")
    header.SetFileName(str(file))
    header.ReadImageInformation()
    if math.prod(header.GetSize()[2:]) > 1:
        frames = math.prod(header.GetSize()[2:])
        raise InputError(f"{file.name} is a DICOM file of {frames} frames, which is not read; convert it to NIfTI")


def itk_header(path: Path) -> Any:
    """Return SimpleITK's reader for a file after reading the header; the ending gives the format."""
    kind = suffix_of(path)
    if kind not in _ITK_READERS:
        raise InputError(f"no volume of a kind that is read; expected {' '.join(VOLUME_SUFFIXES)}")
    if kind in (".mha", ".mhd"):
        with open_regular(path) as stream:
            header = stream.read(HEADER_BYTES).partition(b"ElementDataFile")[0]
        if any(len(line) > _MAX_LINE for line in header.splitlines()):
            raise InputError(f"a line of over {_MAX_LINE} characters in its header")
    for file in (path, *volume_files(path)):
        if not file.is_relative_to(path.parent) or ".." in file.relative_to(path.parent).parts:
            raise InputError(f"its values lie in {file.name}, which is not in its own folder")
        with open_regular(file):  # raises for a pipe, at which the library would hang
            pass
    try:
        str(path).encode()
    except UnicodeEncodeError:
        raise InputError("SimpleITK reads only files whose path is text in UTF-8; rename it") from None
    reader = simple_itk().ImageFileReader()
    reader.SetImageIO(_ITK_READERS[kind])
    reader.SetFileName(str(path))
    with library_errors():
        reader.ReadImageInformation()
    return reader


def _unknown_in_nifti(path: Path, reader: Any) -> NDArray[np.float32] | None:
    """Return the non-finite numbers, 0 for finite ones, or None if all are finite.

    Raise InputError if the file is cut off; ITK would fill it with zeros.
    """
    kind = _NIFTI_FLOATS.get(reader.GetMetaData("datatype"))
    n_values = int(np.prod(reader.GetSize())) * reader.GetNumberOfComponents()
    item = int(reader.GetMetaData("bitpix")) // 8 if kind is None else int(kind[1])
    offset = int(float(reader.GetMetaData("vox_offset")))
    try:
        values = path.with_suffix(".img") if suffix_of(path) == ".hdr" else path
        with gzip.open(values) if path.name.lower().endswith(".gz") else open(values, "rb") as file:
            data = file.read()
    except (OSError, EOFError, zlib.error):
        raise InputError("cut off, or not a gzip file") from None
    if len(data) < offset + n_values * item:
        raise InputError(f"cut off: {len(data)} bytes, its header promises {offset + n_values * item}")
    if kind is None:
        return None
    start = (nifti_header(path) or data)[:2] if suffix_of(path) == ".img" else data[:2]
    start = read_bytes(path)[:2] if suffix_of(path) == ".hdr" else start
    order = "<" if start == struct.pack("<h", 348) else ">"
    stored = np.frombuffer(data, order + kind, n_values, offset)
    known = np.isfinite(stored)
    return None if known.all() else np.where(known, 0, stored).astype(np.float32)


@contextlib.contextmanager
def library_errors() -> Iterator[None]:
    """Turn any error of SimpleITK into an InputError of one line, and drop the output of its C++ code."""
    try:
        with silent():
            yield
    except InputError:
        raise
    except Exception as error:  # RuntimeError, TypeError, and UnicodeDecodeError from its messages
        lines = [line.strip() for line in str(error).splitlines() if line.strip()] or [type(error).__name__]
        reason = next((line.partition("ERROR: ")[2] or line for line in lines if "ERROR" in line), lines[-1])
        raise InputError(f"cannot be read ({reason.partition('): ')[2] or reason})"[:300]) from None


def _dirlab_grid(path: Path) -> Grid:
    """Return the grid of a raw file from ``size`` and ``spacing`` (x, y, z) of meta.json in its folder."""
    meta_file = path.with_name("meta.json")
    try:
        meta = json_object(read_bytes(meta_file, 1 << 20))
        size, spacing = (numbers(meta.get(key), key, (3,)) for key in ("size", "spacing"))
    except InputError:
        raise InputError(f'a raw file needs "size" and "spacing" (x, y, z) in {shown(meta_file)}') from None
    if min(size) < 1 or min(spacing) <= 0 or max(size) > _MAX_SIDE:
        raise InputError(f"{shown(meta_file)}: expected three positive sizes and spacings")
    return Grid((int(size[0]), int(size[1]), int(size[2])), tuple(spacing.tolist()))


def _dirlab(path: Path) -> Volume:
    """Read DIR-Lab's format: little-endian int16, x fastest, slices in the order of its landmarks' indices."""
    grid = _dirlab_grid(path)
    data = read_bytes(path)
    wanted = 2 * grid.size[0] * grid.size[1] * grid.size[2]
    if len(data) != wanted:
        raise InputError(f"{len(data)} bytes, expected {wanted} for {' x '.join(map(str, grid.size))} int16")
    return Volume(np.frombuffer(data, "<i2").reshape(grid.shape).astype(np.float32), grid)


def itk_image(values: NDArray[Any], grid: Grid) -> Any:
    """Return a (Z, Y, X) volume or a (Z, Y, X, 3) field as a SimpleITK image on its grid."""
    image = simple_itk().GetImageFromArray(values, isVector=values.ndim == 4)
    image.SetSpacing(grid.spacing)
    image.SetOrigin(grid.origin)
    image.SetDirection(grid.direction)
    return image


def written_suffix(path: Path) -> str:
    """Return the ending of outputs for an input: its own format if that is written here, otherwise ``.mha``."""
    own = suffix_of(path)
    return {".mhd": ".mha", ".nhdr": ".nrrd"}.get(own, own if own in (".nii", ".nii.gz", ".nrrd") else ".mha")


def write_volume(path: Path, grid: Grid, slab: Slab, vector: bool = False, bytes_: bool = False) -> None:
    """Write slices as float32, or as uint8 if ``bytes_``, to ``.nii``, ``.nii.gz``, ``.mha`` or ``.nrrd``.

    A field is written in mm along LPS, as ITK reads it; in NIfTI with the intent of a vector (1007).
    """
    kind = suffix_of(path)
    nifti = kind in (".nii", ".nii.gz")
    step = max(1, (1 << 21) // (grid.size[0] * grid.size[1]))
    with atomic_path(path) as temporary, open(temporary, "wb") as file, contextlib.ExitStack() as stack:
        packed: Any = file
        if not nifti:
            file.write((_nrrd_header if kind == ".nrrd" else _meta_header)(grid, vector, bytes_))
        if kind in (".nii.gz", ".nrrd"):
            packed = stack.enter_context(gzip.GzipFile("", "wb", 1, file, mtime=0))
        if nifti:
            packed.write(_nifti_header(grid, vector, bytes_))
        for part in range(3) if vector and nifti else (slice(None),):  # NIfTI stores components one after another
            for first in range(0, grid.shape[0], step):
                values = slab(first, min(first + step, grid.shape[0]))
                packed.write(np.ascontiguousarray(values[..., part], "u1" if bytes_ else "<f4").data)


def write_array(path: Path, grid: Grid, values: NDArray[np.float32]) -> None:
    """Write a (Z, Y, X) volume or a (Z, Y, X, 3) field from memory."""
    write_volume(path, grid, lambda first, last: values[first:last], values.ndim == 4)


def _meta_header(grid: Grid, vector: bool, bytes_: bool) -> bytes:
    # MetaImage lists the axes one after another, but ITK's matrix has them as columns.
    axes, origin, spacing = (
        " ".join(f"{v:.17g}" for v in values) for values in (grid.axes.T.ravel(), grid.origin, grid.spacing)
    )
    parts = "ElementNumberOfChannels = 3\n" if vector else ""
    kind = "MET_UCHAR" if bytes_ else "MET_FLOAT"
    return (
        "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\nCompressedData = False\n"
        f"TransformMatrix = {axes}\nOffset = {origin}\nCenterOfRotation = 0 0 0\nAnatomicalOrientation = RAI\n"
        f"ElementSpacing = {spacing}\nDimSize = {' '.join(map(str, grid.size))}\n{parts}ElementType = {kind}\n"
        "ElementDataFile = LOCAL\n"
    ).encode("ascii")


def _nrrd_header(grid: Grid, vector: bool, bytes_: bool) -> bytes:
    columns = (grid.axes * np.array(grid.spacing)).T
    directions = " ".join(f"({','.join(f'{v:.17g}' for v in column)})" for column in columns)
    sizes, number = " ".join(map(str, grid.size)), "uint8" if bytes_ else "float"
    kinds = "domain domain domain"
    if vector:
        sizes, kinds, directions = f"3 {sizes}", f"vector {kinds}", f"none {directions}"
    return (
        f"NRRD0004\ntype: {number}\ndimension: {4 if vector else 3}\nspace: left-posterior-superior\nsizes: {sizes}\n"
        f"space directions: {directions}\nkinds: {kinds}\nendian: little\nencoding: gzip\n"
        f"space origin: ({','.join(f'{v:.17g}' for v in grid.origin)})\n\n"
    ).encode("ascii")


def _nifti_header(grid: Grid, vector: bool, bytes_: bool) -> bytes:
    """Return the header of a float32 or uint8 volume, or of a vector field (intent 1007)."""
    header = bytearray(352)  # the last four bytes are the extension flags
    struct.pack_into("<i", header, 0, 348)
    x, y, z = grid.size
    struct.pack_into("<8h", header, 40, *((5, x, y, z, 1, 3, 1, 1) if vector else (3, x, y, z, 1, 1, 1, 1)))
    struct.pack_into("<3h", header, 68, 1007 if vector else 0, *((2, 8) if bytes_ else (16, 32)))
    axes = np.diag([-1.0, -1.0, 1.0]) @ grid.axes  # RAS
    origin = np.array([-1.0, -1.0, 1.0]) * np.array(grid.origin)
    flip = -1.0 if np.linalg.det(axes) < 0 else 1.0
    rotation = axes.copy()
    rotation[:, 2] *= flip
    struct.pack_into("<8f", header, 76, flip, *grid.spacing, 1, 1, 1, 1)
    struct.pack_into("<f", header, 108, 352.0)
    struct.pack_into("<f", header, 112, 1.0)
    header[123] = 2  # mm
    struct.pack_into("<2h", header, 252, 1, 1)
    struct.pack_into("<6f", header, 256, *_quaternion(rotation), *origin)
    affine = np.column_stack([axes * np.array(grid.spacing), origin])
    struct.pack_into("<12f", header, 280, *affine.ravel())
    header[344:348] = b"n+1\0"
    return bytes(header)


def _quaternion(rotation: NDArray[np.float64]) -> tuple[float, float, float]:
    """Return b, c, d of a proper rotation's quaternion, with a >= 0 (the NIfTI standard's method)."""
    trace = float(np.trace(rotation))
    if trace > -0.5:
        a = 0.5 * np.sqrt(max(1 + trace, 0.0))
        skew = rotation - rotation.T
        b, c, d = np.array([skew[2, 1], skew[0, 2], skew[1, 0]]) / (4 * a)
        return float(b), float(c), float(d)
    diagonal = np.diag(rotation)
    k = int(np.argmax(diagonal))
    i, j = (k + 1) % 3, (k + 2) % 3
    root = np.sqrt(max(1 + diagonal[k] - diagonal[i] - diagonal[j], 0.0))
    q = np.zeros(3)
    q[k] = 0.5 * root
    q[i] = (rotation[i, k] + rotation[k, i]) / (2 * root)
    q[j] = (rotation[j, k] + rotation[k, j]) / (2 * root)
    if rotation[j, i] - rotation[i, j] < 0:
        q = -q
    return float(q[0]), float(q[1]), float(q[2])


# Files that another file needs: the values of a volume, a chain of transforms.


def volume_files(path: Path) -> tuple[Path, ...]:
    """Return the files that a volume needs: its data files, its header or ``meta.json``, or all files of a folder."""
    if os.path.isdir(path):  # a DICOM series
        return tuple(sorted(file for file in path.glob("*") if os.path.isfile(file)))
    kind = path.suffix.lower()
    if kind == ".hdr":
        return (path.with_suffix(".img"),)
    if kind == ".img":
        with contextlib.suppress(InputError):  # reading the volume reports the problem
            return (path.with_suffix(".hdr") if nifti_header(path) else path.with_name("meta.json"),)
        return ()
    if kind not in (".mha", ".mhd", ".nrrd", ".nhdr"):
        return ()
    found = None
    with contextlib.suppress(InputError), open_regular(path) as file:  # reading the volume reports the problem
        found = _DATA_FILE.search(file.read(HEADER_BYTES))
    name = os.fsdecode(found[1]).strip() if found else "LOCAL"
    if found and name.split()[0] == "LIST":
        return tuple(path.parent / each.strip() for each in os.fsdecode(found[2]).splitlines() if each.strip())
    if "%" in name:  # a pattern of numbered files
        return tuple(sorted(path.parent.glob(re.sub(r"%\d*d", "*", name.split()[0]))))
    return () if name in ("LOCAL", "Local", "local") else (path.parent / name,)


def transform_files(path: Path) -> tuple[Path, ...]:
    """Return the further files of a chain of elastix parameter files, without ``path``."""
    files: list[Path] = []
    with contextlib.suppress(InputError):  # reading the transform reports the problem
        while path.suffix.lower() == ".txt" and len(files) < MAX_CHAIN:
            text = text_of(read_bytes(path, MAX_TRANSFORM_BYTES))
            below = initial_transform(path, text) if "(Transform " in text else None
            if below is None or below in files:
                break
            files.append(below)
            path = below
    return tuple(files)


def initial_transform(path: Path, text: str) -> Path | None:
    """Return an elastix transform's initial transform, in the same folder or at its stored path, or None."""
    found = _INITIAL.findall(text)
    name = found[-1].strip('"') if found else ""
    if name in ("", "NoInitialTransform"):
        return None
    sibling, elsewhere = path.parent / Path(name).name, Path(name)
    return elsewhere if not sibling.is_file() and elsewhere.is_file() else sibling
