"""Volumes: NIfTI, MetaImage, NRRD and DIR-Lab raw through SimpleITK; two-dimensional images as one slice.

SimpleITK is an extra (``pip install depthcli[medical]``) and imported here and in ``io/fields.py`` only.
"""

from __future__ import annotations

import contextlib
import gzip
import json
import struct
import warnings
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import DepthcliError, InputError
from depthcli.data.formats.files import naming, open_regular, read_bytes, shown
from depthcli.data.formats.headers import image_size
from depthcli.data.formats.images import IMAGE_SUFFIXES, read_grey

VOLUME_SUFFIXES = (".nii", ".nii.gz", ".mha", ".mhd", ".nrrd", ".nhdr", ".img")
"""Endings of volume files; ``.img`` is DIR-Lab's raw format, with its size in ``meta.json``."""


@dataclass(frozen=True)
class Grid:
    """Where the voxels of a volume are, in mm and in the LPS frame of ITK.

    Attributes
    ----------
    size : voxels along x, y, z
    spacing : mm along the volume's own axes
    origin : position of the first voxel
    direction : (3, 3), columns are the axes
    """

    size: tuple[int, int, int]
    spacing: tuple[float, float, float]
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    direction: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)

    @property
    def shape(self) -> tuple[int, int, int]:
        """(Z, Y, X)."""
        return self.size[2], self.size[1], self.size[0]

    @property
    def axes(self) -> NDArray[np.float64]:
        """(3, 3) columns are the axes."""
        return np.array(self.direction).reshape(3, 3)

    def to_index(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """(N, 3) positions x, y, z in mm as places z, y, x in voxels."""
        own = (points - np.array(self.origin)) @ np.linalg.inv(self.axes).T
        places: NDArray[np.float64] = (own / np.array(self.spacing))[:, ::-1]
        return places

    def to_point(self, places: NDArray[np.float64]) -> NDArray[np.float64]:
        """(N, 3) places z, y, x in voxels as positions x, y, z in mm."""
        points: NDArray[np.float64] = (places[:, ::-1] * np.array(self.spacing)) @ self.axes.T + np.array(self.origin)
        return points

    def same_as(self, other: Grid) -> bool:
        """Voxels lie at the same places, up to a hundredth of a voxel."""
        if self.size != other.size:
            return False
        slack = 0.01 * min(self.spacing)
        corners = np.array([[0, 0, 0], [self.size[2] - 1, self.size[1] - 1, self.size[0] - 1]], float)
        return bool(np.allclose(self.to_point(corners), other.to_point(corners), atol=slack, rtol=0))


@dataclass(frozen=True)
class Volume:
    """(Z, Y, X) float32 values, or (Z, Y, X, 3) of a vector field, and where they are."""

    values: NDArray[np.float32]
    grid: Grid


def linear(values: NDArray[np.float32], places: NDArray[np.float64]) -> NDArray[np.float32]:
    """Trilinear values at (N, 3) places z, y, x in voxels, borders repeated."""
    top = np.array(values.shape) - 1
    place = np.clip(places, 0, top)
    low = np.minimum(place.astype(np.int64), np.maximum(top - 1, 0))
    weight = place - low
    total = np.zeros(len(places))
    for corner in np.ndindex(2, 2, 2):
        at = np.minimum(low + corner, top)
        share = np.prod(np.where(np.array(corner) == 1, weight, 1 - weight), axis=1)
        total += share * values[at[:, 0], at[:, 1], at[:, 2]]
    return total.astype(np.float32)


def block_means(values: NDArray[Any], blocks: tuple[int, int, int]) -> NDArray[np.float32]:
    """(z, y, x) float32 means of blocks of voxels, smaller ones at the far borders; slice by slice."""
    if max(blocks) == 1:
        return values.astype(np.float32, copy=False)
    starts = [np.arange(0, n, b) for n, b in zip(values.shape, blocks, strict=True)]
    counts = [np.diff([*start, n]) for start, n in zip(starts, values.shape, strict=True)]
    plane = counts[1][:, None] * counts[2][None, :]
    out = np.empty([len(start) for start in starts], np.float32)
    for k, first in enumerate(starts[0]):
        total = values[first : first + blocks[0]].sum(axis=0, dtype=np.float64)
        rows = np.add.reduceat(np.add.reduceat(total, starts[1], axis=0), starts[2], axis=1)
        out[k] = rows / (plane * counts[0][k])
    return out


def suffix_of(path: Path) -> str:
    """Ending of a file, with both parts of ``.nii.gz``."""
    return ".nii.gz" if path.name.lower().endswith(".nii.gz") else path.suffix.lower()


def simple_itk() -> Any:
    """SimpleITK; InputError that says how to install it."""
    try:
        with warnings.catch_warnings():
            # SWIG's types lack a __module__ attribute, which Python 3.12 and newer deprecate.
            warnings.simplefilter("ignore", DeprecationWarning)
            import SimpleITK
    except ImportError:
        raise InputError("medical volumes need SimpleITK: pip install 'depthcli[medical]'") from None
    SimpleITK.ProcessObject.SetGlobalWarningDisplay(False)
    return SimpleITK


def read_volume(path: Path, vector: bool = False) -> Volume:
    """Read a volume, or a field of three components.

    Raises
    ------
    InputError
        Not readable, cut off, of more than three dimensions, with another number of components than asked for,
        without a spacing, or empty.
    """
    with naming(path):
        if suffix_of(path) in IMAGE_SUFFIXES:
            plane = read_grey(path)
            return Volume(plane.astype(np.float32)[None], Grid((plane.shape[1], plane.shape[0], 1), (1.0, 1.0, 1.0)))
        if suffix_of(path) == ".img":
            return _dirlab(path)
        bad = _check_whole(path)
        volume = _volume(read_image(path), vector)
        if bad.size:
            # In the file a field's components lie one after another.
            in_order = np.moveaxis(volume.values, -1, 0) if vector else volume.values
            in_order[np.unravel_index(bad[bad < in_order.size], in_order.shape)] = np.nan
        return volume


def read_grid(path: Path) -> Grid:
    """Where the voxels of a volume are, by its header alone; InputError as :func:`read_volume`."""
    with naming(path):
        if suffix_of(path) in IMAGE_SUFFIXES:
            plane = image_size(path)
            return Grid((plane.width, plane.height, 1), (1.0, 1.0, 1.0))
        if suffix_of(path) == ".img":
            return _dirlab_grid(path)
        reader = simple_itk().ImageFileReader()
        reader.SetFileName(str(path))
        with _one_line(), quiet():
            reader.ReadImageInformation()
        size, spacing = reader.GetSize()[:3], reader.GetSpacing()[:3]
        if not 2 <= reader.GetDimension() <= 4 or not all(np.isfinite(s) and s > 0 for s in spacing):
            raise InputError(f"{reader.GetDimension()}-D, with a spacing of {spacing}")
        size, spacing = (*size, 1)[:3], (*spacing, 1.0)[:3]
        return Grid((size[0], size[1], size[2]), (spacing[0], spacing[1], spacing[2]))


def read_image(path: Path) -> Any:
    """The SimpleITK image; InputError with the reason in one line."""
    sitk = simple_itk()
    with _one_line(), quiet():
        return sitk.ReadImage(str(path))


@contextlib.contextmanager
def _one_line() -> Any:
    """Errors of SimpleITK as an InputError with the reason in one line."""
    try:
        yield
    except RuntimeError as error:
        lines = [line.strip() for line in str(error).splitlines() if line.strip()]
        reason = next((line.partition("ERROR: ")[2] or line for line in lines if "ERROR" in line), lines[-1])
        if "spacing" in str(error):
            reason = "a spacing of 0"
        raise InputError(f"cannot be read ({reason.partition('): ')[2] or reason})"[:300]) from None


def _volume(image: Any, vector: bool) -> Volume:
    sitk = simple_itk()
    dimension, parts = image.GetDimension(), image.GetNumberOfComponentsPerPixel()
    size = image.GetSize()
    if dimension == 4 and size[3] == 1:
        image = sitk.Extract(image, [*size[:3], 0], [0, 0, 0, 0])
        dimension = 3
    if dimension not in (2, 3):
        raise InputError(f"{dimension}-D ({' x '.join(map(str, size))}), want a single volume")
    if dimension == 2:
        image = sitk.JoinSeries(image)
        if vector and parts == 2:
            raise InputError("a 2-D field of two components; want three")
    wanted = 3 if vector else 1
    if parts != wanted:
        raise InputError(f"{parts} values a voxel, want {wanted}")
    values = sitk.GetArrayViewFromImage(image)
    if values.size == 0:
        raise InputError("no voxels")
    spacing = image.GetSpacing()
    if not all(np.isfinite(s) and s > 0 for s in spacing):
        raise InputError(f"a spacing of {spacing}")
    grid = Grid(tuple(image.GetSize()), tuple(spacing), tuple(image.GetOrigin()), tuple(image.GetDirection()))
    return Volume(np.array(values, np.float32, order="C"), grid)


@contextlib.contextmanager
def quiet() -> Any:
    """Without what the readers' C++ prints: the message comes with the exception."""
    import os

    try:
        saved = os.dup(2)
        sink = os.open(os.devnull, os.O_WRONLY)
    except OSError:
        yield
        return
    try:
        os.dup2(sink, 2)
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)
        os.close(sink)


def _check_whole(path: Path) -> NDArray[np.int64]:
    """Refuse what SimpleITK would fill up with zeros or mend in silence; places of the values it would make zero.

    Those are the numbers of a NIfTI file that are not finite, counted in the order of the file.
    """
    bad: list[NDArray[np.int64]] = []
    header, length = b"", 0
    fields: dict[str, Any] = {}

    def take(block: bytes) -> None:
        kind = fields["float"]
        if kind:
            values = np.frombuffer(block, kind, len(block) // np.dtype(kind).itemsize)
            found = np.flatnonzero(~np.isfinite(values))
            if found.size:
                bad.append(found + (length - fields["offset"]) // np.dtype(kind).itemsize)

    with open_regular(path) as file:
        if suffix_of(path) == ".nii.gz":
            try:
                with gzip.GzipFile(fileobj=file) as unpacked:
                    header = unpacked.read(352)
                    fields = nifti_fields(header)
                    length = len(header) + len(unpacked.read(max(0, fields["offset"] - 352)))
                    while block := unpacked.read(1 << 24):
                        take(block)
                        length += len(block)
            except (OSError, EOFError, zlib.error):
                raise InputError("cut off, or not a gzip file") from None
        elif suffix_of(path) == ".nii":
            header = file.read(352)
            fields = nifti_fields(header)
            length = file.seek(max(352, fields["offset"]))
            while block := file.read(1 << 24):
                take(block)
                length += len(block)
        else:
            return np.zeros(0, np.int64)
    if length < fields["offset"] + fields["bytes"]:
        raise InputError(f"cut off: {length} bytes, its header promises {fields['offset'] + fields['bytes']}")
    if any(not np.isfinite(s) or s == 0 for s in fields["spacing"]):
        raise InputError("a spacing of 0")
    return np.concatenate(bad) if bad else np.zeros(0, np.int64)


def nifti_fields(header: bytes) -> dict[str, Any]:
    """What is needed of a NIfTI-1 header; InputError where it is none."""
    if len(header) < 348:
        raise InputError("cut off within the header")
    order = "<" if struct.unpack_from("<i", header)[0] == 348 else ">"
    if struct.unpack_from(order + "i", header)[0] != 348:
        raise InputError("no NIfTI-1 header")
    dim = struct.unpack_from(order + "8h", header, 40)
    count = min(max(dim[0], 1), 7)
    pixdim = struct.unpack_from(order + "8f", header, 76)
    voxels = 1
    for n in dim[1 : 1 + count]:
        voxels *= max(int(n), 1)
    return {
        "dim": dim[1 : 1 + count],
        "spacing": pixdim[1 : 1 + min(count, 3)],
        "offset": int(struct.unpack_from(order + "f", header, 108)[0]),
        "bytes": voxels * struct.unpack_from(order + "h", header, 72)[0] // 8,
        "float": {16: order + "f4", 64: order + "f8"}.get(struct.unpack_from(order + "h", header, 70)[0], ""),
        "intent": struct.unpack_from(order + "h", header, 68)[0],
        "intent_p1": struct.unpack_from(order + "f", header, 56)[0],
        "intent_name": header[328:344].split(b"\0")[0].decode("latin-1").strip(),
    }


def nifti_header(path: Path) -> dict[str, Any]:
    """Header fields of a NIfTI file."""
    with open_regular(path) as file:
        try:
            if suffix_of(path) == ".nii.gz":
                with gzip.GzipFile(fileobj=file) as unpacked:
                    return nifti_fields(unpacked.read(352))
            return nifti_fields(file.read(352))
        except (OSError, EOFError, zlib.error):
            raise InputError("cut off, or not a gzip file") from None


def _dirlab_grid(path: Path) -> Grid:
    """What the file beside a raw volume says."""
    meta_file = path.parent / "meta.json"
    try:
        meta = json.loads(read_bytes(meta_file, 1 << 20))
        size = tuple(int(n) for n in meta["size"])
        spacing = tuple(float(s) for s in meta["spacing"])
    except (DepthcliError, ValueError, KeyError, TypeError):
        raise InputError(f'a raw file wants "size" and "spacing" (x, y, z) in {shown(meta_file)}') from None
    if len(size) != 3 or len(spacing) != 3 or min(size) < 1 or not all(np.isfinite(s) and s > 0 for s in spacing):
        raise InputError(f"{shown(meta_file)}: want three positive sizes and spacings")
    return Grid((size[0], size[1], size[2]), (spacing[0], spacing[1], spacing[2]))


def _dirlab(path: Path) -> Volume:
    """DIR-Lab: little-endian int16, x fastest, slices in the order in which its landmarks count them."""
    grid = _dirlab_grid(path)
    data = read_bytes(path)
    wanted = 2 * grid.size[0] * grid.size[1] * grid.size[2]
    if len(data) != wanted:
        raise InputError(f"{len(data)} bytes, want {wanted} for {' x '.join(map(str, grid.size))} int16")
    return Volume(np.frombuffer(data, "<i2").reshape(grid.shape).astype(np.float32), grid)
