"""Headers of NIfTI-1 files, read and written, and whether such a file is whole."""

from __future__ import annotations

import gzip
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.core.volumes import Grid
from depthcli.data.formats.files import open_regular

_HEADER_BYTES = 352  # with the four that say whether extensions follow


def check_whole(path: Path) -> NDArray[np.int64]:
    """Refuse a NIfTI file that SimpleITK would fill up with zeros or mend in silence.

    Returns
    -------
    (N,) positions, in the order of the file, of the numbers that are not finite, which SimpleITK would make zero;
    none for other formats
    """
    bad: list[NDArray[np.int64]] = []
    header, length = b"", 0
    fields: dict[str, Any] = {}

    def take(block: bytes) -> None:
        kind = fields["float"]
        if kind:
            values = np.frombuffer(block, kind, len(block) // np.dtype(kind).itemsize)
            places = np.flatnonzero(~np.isfinite(values))
            if places.size:
                bad.append(places + (length - fields["offset"]) // np.dtype(kind).itemsize)

    with open_regular(path) as file:
        if path.name.lower().endswith(".nii.gz"):
            try:
                with gzip.GzipFile(fileobj=file) as unpacked:
                    header = unpacked.read(_HEADER_BYTES)
                    fields = _fields(header)
                    length = len(header) + len(unpacked.read(max(0, fields["offset"] - _HEADER_BYTES)))
                    while block := unpacked.read(1 << 24):
                        take(block)
                        length += len(block)
            except (OSError, EOFError, zlib.error):
                raise InputError("cut off, or not a gzip file") from None
        elif path.suffix.lower() == ".nii":
            header = file.read(_HEADER_BYTES)
            fields = _fields(header)
            length = file.seek(max(_HEADER_BYTES, fields["offset"]))
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


def _fields(header: bytes) -> dict[str, Any]:
    """What is needed of the header; InputError where it is none."""
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


def read_header(path: Path) -> dict[str, Any]:
    """Return the header fields of a NIfTI file; InputError where it has none."""
    with open_regular(path) as file:
        try:
            if path.name.lower().endswith(".nii.gz"):
                with gzip.GzipFile(fileobj=file) as unpacked:
                    return _fields(unpacked.read(_HEADER_BYTES))
            return _fields(file.read(_HEADER_BYTES))
        except (OSError, EOFError, zlib.error):
            raise InputError("cut off, or not a gzip file") from None


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
