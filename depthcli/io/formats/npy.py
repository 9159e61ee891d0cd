"""NumPy's ``.npy`` and ``.npz`` files, read by a strict parser, which names any damage of the header."""

from __future__ import annotations

import math
import os
import re
import zipfile
import zlib
from io import BytesIO
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.io.formats.files import naming, open_regular

NPY_MAGIC = b"\x93NUMPY"
NPZ_MAGIC = b"PK\x03\x04"

_MAX_UNPACKED_BYTES = 1 << 30  # of an array in an .npz file, as much as the largest images take
_MAP_NAMES = ("disp", "disparity", "disp_left", "depth", "arr_0")  # arrays that are taken of several in an .npz file

_HEADER_BYTES = 1 << 16  # longest header of version 1
_DTYPE = re.compile(rb"""['"]descr['"]\s*:\s*['"]([<>=|]?(?:[iuf][1248]|b1))['"]""")
_ORDER = re.compile(rb"""['"]fortran_order['"]\s*:\s*(True|False)""")
_SHAPE = re.compile(rb"""['"]shape['"]\s*:\s*\(([\d\sL,]{0,200})\)""")


class _Layout(NamedTuple):
    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    order: Literal["C", "F"]
    start: int
    values: int


def decode_npy(data: bytes) -> NDArray[Any]:
    """Return the (H, W) array of numbers in the bytes of a ``.npy`` file, never empty.

    Raises
    ------
    InputError
        Damaged, or holding anything else.
    """
    layout = _layout(data[:_HEADER_BYTES], len(data), 2)
    return np.frombuffer(data, layout.dtype, layout.values, layout.start).reshape(layout.shape, order=layout.order)


def npy_in_npz(data: bytes) -> bytes:
    """Return the ``.npy`` bytes of the map in the bytes of an ``.npz`` file: its only array, or the one named as a map.

    Raises
    ------
    InputError
        Damaged, too large, or several arrays of which none, or more than one, is named as a map.
    """
    try:
        with zipfile.ZipFile(BytesIO(data)) as archive:
            members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
            named = [name for name in _MAP_NAMES if name in members]
            chosen = list(members) if len(members) == 1 else named
            if len(chosen) != 1:
                raise InputError(
                    f"an .npz file of {len(members)} arrays ({', '.join(members)[:200]}); want a single one, or one "
                    f"of them called {', '.join(_MAP_NAMES)}"
                )
            if members[chosen[0]].file_size > _MAX_UNPACKED_BYTES:
                raise InputError(f"too large: {members[chosen[0]].file_size} bytes")
            return archive.read(members[chosen[0]])
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, OSError, ValueError) as error:
        raise InputError(f"damaged .npz file ({error})") from error


def map_npy(path: Path | str, dimensions: int) -> NDArray[Any]:
    """Return the array of a ``.npy`` file, mapped into memory, so that only the parts in use are read.

    Raises
    ------
    InputError
        Not readable, damaged, or not an array of numbers with ``dimensions`` axes.
    """
    with open_regular(path) as file, naming(path):
        layout = _layout(file.read(_HEADER_BYTES), os.fstat(file.fileno()).st_size, dimensions)
        return np.memmap(file, layout.dtype, "r", layout.start, layout.shape, layout.order)


def npy_shape(data: bytes, size: int) -> tuple[tuple[int, ...], int]:
    """Return shape and bits per value, from the first bytes of a file of ``size`` bytes; InputError if damaged."""
    layout = _layout(data, size, None)
    return layout.shape, 8 * layout.dtype.itemsize


def _layout(data: bytes, size: int, dimensions: int | None) -> _Layout:
    if data[:6] != NPY_MAGIC or len(data) < 12:
        raise InputError("not an .npy array")
    wide = data[6] > 1  # from version 2 on, the length of the header has four bytes
    start = 12 + int.from_bytes(data[8:12], "little") if wide else 10 + int.from_bytes(data[8:10], "little")
    header = data[:start]
    dtype, order, shape = _DTYPE.search(header), _ORDER.search(header), _SHAPE.search(header)
    lengths = re.findall(rb"\d+", shape[1]) if shape else []
    if start > len(data) or order is None or shape is None or any(len(n) > 15 for n in lengths):
        raise InputError("damaged .npy header")
    numbers = tuple(int(n) for n in lengths)
    if dtype is None or dimensions not in (None, len(numbers)) or 0 in numbers:
        wanted = {2: "an (H, W) array", 3: "an (H, W, D) array"}.get(dimensions or 0, "an array")
        raise InputError(f"want {wanted} of numbers, got shape {numbers}{'' if dtype else ' of another type'}")
    kind = np.dtype(dtype[1].decode("ascii"))
    count = math.prod(numbers)
    if start + count * kind.itemsize > size:
        raise InputError(f"damaged .npy file ({count * kind.itemsize} bytes announced, {size - start} there)")
    return _Layout(kind, numbers, "F" if order[1] == b"True" else "C", start, count)
