"""Volumes to files: NIfTI, MetaImage, NRRD.

Written by hand, slab by slab, so that a volume larger than the memory can be written, and with the same bytes always.
"""

from __future__ import annotations

import gzip
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from depthcli.data.formats.atomic import atomic_path
from depthcli.data.formats.volumes import Grid, suffix_of

Slab = Callable[[int, int], NDArray[np.float32]]
"""Slices ``first`` up to ``last`` of a volume, (n, Y, X), or (n, Y, X, 3) of a vector field."""


def written_suffix(path: Path) -> str:
    """Ending of what is written for an input: its own format where that holds real numbers."""
    own = suffix_of(path)
    return {".mhd": ".mha", ".nhdr": ".nrrd"}.get(own, own if own in (".nii", ".nii.gz", ".nrrd") else ".mha")


def write_volume(path: Path, grid: Grid, slab: Slab, vector: bool = False) -> None:
    """Write float32 slices as they come, in the format of the ending (``.nii``, ``.nii.gz``, ``.mha``, ``.nrrd``).

    A field is written in mm along LPS, as ITK reads it; in NIfTI with the intent of a vector (1007).
    """
    kind = suffix_of(path)
    with atomic_path(path) as temporary, open(temporary, "wb") as file:
        if kind in (".nii", ".nii.gz"):
            _write_nifti(file, grid, slab, vector, kind == ".nii.gz")
        elif kind == ".nrrd":
            file.write(_nrrd_header(grid, vector))
            with gzip.GzipFile("", "wb", 1, file, mtime=0) as packed:
                _write_slabs(packed, grid, slab, None)
        else:
            file.write(_meta_header(grid, vector))
            _write_slabs(file, grid, slab, None)


def write_array(path: Path, grid: Grid, values: NDArray[np.float32]) -> None:
    """Write a (Z, Y, X) volume or a (Z, Y, X, 3) field that is in memory."""
    write_volume(path, grid, lambda first, last: values[first:last], values.ndim == 4)


def _write_slabs(file: Any, grid: Grid, slab: Slab, part: int | None) -> None:
    depth = grid.shape[0]
    step = max(1, (1 << 21) // (grid.size[0] * grid.size[1]))
    for first in range(0, depth, step):
        values = slab(first, min(first + step, depth))
        file.write(np.ascontiguousarray(values if part is None else values[..., part], "<f4").data)


def _write_nifti(file: BinaryIO, grid: Grid, slab: Slab, vector: bool, packed: bool) -> None:
    target: Any = gzip.GzipFile("", "wb", 1, file, mtime=0) if packed else file
    target.write(_nifti_bytes(grid, vector))
    for part in range(3) if vector else (None,):
        _write_slabs(target, grid, slab, part)
    if packed:
        target.close()


def _nifti_bytes(grid: Grid, vector: bool) -> bytes:
    header = bytearray(352)
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


def _meta_header(grid: Grid, vector: bool) -> bytes:
    # MetaImage lists the axes one after another; ITK's matrix has them as columns.
    axes = " ".join(f"{v:.17g}" for v in grid.axes.T.ravel())
    parts = "ElementNumberOfChannels = 3\n" if vector else ""
    return (
        "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\nCompressedData = False\n"
        f"TransformMatrix = {axes}\nOffset = {' '.join(f'{v:.17g}' for v in grid.origin)}\n"
        "CenterOfRotation = 0 0 0\nAnatomicalOrientation = RAI\n"
        f"ElementSpacing = {' '.join(f'{v:.17g}' for v in grid.spacing)}\n"
        f"DimSize = {' '.join(map(str, grid.size))}\n{parts}ElementType = MET_FLOAT\nElementDataFile = LOCAL\n"
    ).encode("ascii")


def _nrrd_header(grid: Grid, vector: bool) -> bytes:
    columns = (grid.axes * np.array(grid.spacing)).T
    directions = " ".join(f"({','.join(f'{v:.17g}' for v in column)})" for column in columns)
    sizes = " ".join(map(str, grid.size))
    kinds = "domain domain domain"
    if vector:
        sizes, kinds, directions = f"3 {sizes}", f"vector {kinds}", f"none {directions}"
    return (
        f"NRRD0004\ntype: float\ndimension: {4 if vector else 3}\nspace: left-posterior-superior\nsizes: {sizes}\n"
        f"space directions: {directions}\nkinds: {kinds}\nendian: little\nencoding: gzip\n"
        f"space origin: ({','.join(f'{v:.17g}' for v in grid.origin)})\n\n"
    ).encode("ascii")
