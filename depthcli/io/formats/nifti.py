"""Headers of NIfTI-1 files, read and written, and whether such a file is whole."""

from __future__ import annotations

import contextlib
import gzip
import math
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.core.volumes import Grid
from depthcli.io.formats.files import open_regular

MAX_VOLUME_BYTES = 1 << 44
"""Size that the header of a volume may announce; larger than any memory."""

_HEADER_BYTES = 352  # with the four that say whether extensions follow
_MAX_OFFSET = 1 << 30  # of the voxels, behind extensions
# Bytes of a value of the NIfTI-1 datatypes that are real numbers, by their code.
_VALUE_BYTES = {2: 1, 4: 2, 8: 4, 16: 4, 64: 8, 256: 1, 512: 2, 768: 4, 1024: 8, 1280: 8}


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """The bytes of a ``.nii`` or ``.nii.gz`` file; InputError where they are no gzip file, or one that is cut off."""
    with open_regular(path) as file:
        if not path.name.lower().endswith(".gz"):
            yield file
            return
        try:
            with gzip.GzipFile(fileobj=file) as unpacked:
                yield unpacked
        except (OSError, EOFError, zlib.error):
            raise InputError("cut off, or not a gzip file") from None


def check_whole(path: Path) -> NDArray[np.int64]:
    """Refuse a NIfTI file that SimpleITK would fill up with zeros or mend in silence.

    Returns
    -------
    (N,) positions, in the order of the file, of the numbers that are not finite, which SimpleITK would make zero;
    none for other formats
    """
    bad: list[NDArray[np.int64]] = []
    if not path.name.lower().endswith((".nii", ".nii.gz")):
        return np.zeros(0, np.int64)
    with _opened(path) as file:
        fields = _fields(file.read(_HEADER_BYTES))
        length = file.seek(fields["offset"])
        while block := file.read(1 << 24):
            if kind := fields["float"]:
                values = np.frombuffer(block, kind, len(block) // np.dtype(kind).itemsize)
                places = np.flatnonzero(~np.isfinite(values))
                bad.append(places + (length - fields["offset"]) // values.itemsize)
            length += len(block)
    if length < fields["offset"] + fields["bytes"]:
        raise InputError(f"cut off: {length} bytes, its header promises {fields['offset'] + fields['bytes']}")
    return np.concatenate(bad) if bad else np.zeros(0, np.int64)


def _fields(header: bytes) -> dict[str, Any]:
    """What is needed of the header; InputError where it is none."""
    if len(header) < 348:
        raise InputError("cut off within the header")
    order = "<" if struct.unpack_from("<i", header)[0] == 348 else ">"
    if struct.unpack_from(order + "i", header)[0] != 348:
        raise InputError("no NIfTI-1 header")
    if header[344:348] != b"n+1\0":
        raise InputError("want a NIfTI-1 file of one part (n+1)")
    n_dims, *dim = struct.unpack_from(order + "8h", header, 40)
    kind = struct.unpack_from(order + "h", header, 70)[0]
    if kind not in _VALUE_BYTES:
        raise InputError(f"datatype {kind}: not one that is read")
    if not 2 <= n_dims <= 7 or not 0 < math.prod(map(max, dim[:n_dims], [0] * 7)) < MAX_VOLUME_BYTES // 8:
        raise InputError(f"a size that makes no sense ({n_dims} dimensions, {' x '.join(map(str, dim))})")
    spacing = struct.unpack_from(order + "3f", header, 80)[: min(n_dims, 3)]
    if not all(math.isfinite(s) and s != 0 for s in spacing):
        raise InputError("a spacing of 0, or of no number")
    offset = struct.unpack_from(order + "f", header, 108)[0]
    if not _HEADER_BYTES <= offset < _MAX_OFFSET:
        raise InputError(f"vox_offset: want where the voxels begin, from {_HEADER_BYTES} on (got {offset:g})")
    return {
        "dim": tuple(dim[:n_dims]),
        "offset": int(offset),
        "bytes": math.prod(dim[:n_dims]) * _VALUE_BYTES[kind],
        "float": {16: order + "f4", 64: order + "f8"}.get(kind, ""),
        "intent": struct.unpack_from(order + "h", header, 68)[0],
        "intent_p1": struct.unpack_from(order + "f", header, 56)[0],
        "intent_name": header[328:344].split(b"\0")[0].decode("latin-1").strip(),
    }


def read_header(path: Path) -> dict[str, Any]:
    """Return the header fields of a NIfTI file; InputError where it has none."""
    with _opened(path) as file:
        return _fields(file.read(_HEADER_BYTES))


def encode_header(grid: Grid, vector: bool) -> bytes:
    """Return the header of a float32 volume, or of a vector field (intent 1007)."""
    header = bytearray(_HEADER_BYTES)
    struct.pack_into("<i", header, 0, 348)
    x, y, z = grid.size
    struct.pack_into("<8h", header, 40, *((5, x, y, z, 1, 3, 1, 1) if vector else (3, x, y, z, 1, 1, 1, 1)))
    struct.pack_into("<3h", header, 68, 1007 if vector else 0, 16, 32)
    axes = np.diag([-1.0, -1.0, 1.0]) @ grid.axes  # RAS
    origin = np.array([-1.0, -1.0, 1.0]) * np.array(grid.origin)
    flip = -1.0 if np.linalg.det(axes) < 0 else 1.0
    rotation = axes.copy()
    rotation[:, 2] *= flip
    struct.pack_into("<8f", header, 76, flip, *grid.spacing, 1, 1, 1, 1)
    struct.pack_into("<f", header, 108, float(_HEADER_BYTES))
    struct.pack_into("<f", header, 112, 1.0)
    header[123] = 2  # mm
    struct.pack_into("<2h", header, 252, 1, 1)
    struct.pack_into("<6f", header, 256, *_quaternion(rotation), *origin)
    affine = np.column_stack([axes * np.array(grid.spacing), origin])
    struct.pack_into("<12f", header, 280, *affine.ravel())
    header[344:348] = b"n+1\0"
    return bytes(header)


def _quaternion(rotation: NDArray[np.float64]) -> tuple[float, float, float]:
    """b, c, d of a proper rotation, with a >= 0 (the NIfTI standard's method)."""
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
