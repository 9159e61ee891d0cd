"""Disparity maps and other float maps as files: PFM, KITTI PNG, scaled 8-bit images, npy, npz."""

from __future__ import annotations

import math
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.io.formats.files import naming, open_regular, read_bytes, shown, warn, write_bytes
from depthcli.io.formats.images import NPY_MAGIC, decode_numbers, image_kind, pfm_header, png_bytes, read_grey
from depthcli.io.formats.map_format import read_by_plugin

KITTI_SCALE = 256.0
"""Codes per pixel of 16-bit disparity PNGs (KITTI, DSEC)."""

_SAY_SCALE = "say it in meta.json: disp_scale (of maps: --scale)"
_MAX_BEHIND = 0.5  # share of a map's values that may be negative
_NPZ_MAGIC = b"PK\x03\x04"
_MAX_UNPACKED_BYTES = 1 << 30  # of an array in an .npz file, as much as the largest images take
_MAP_NAMES = ("disp", "disparity", "disp_left", "depth", "arr_0")  # arrays that are taken of several in an .npz file


def without_value(stored: NDArray[Any], invalid: float | None = None, positive: bool = False) -> NDArray[np.bool_]:
    """Return where the numbers of a map mean no value, for any reader of maps.

    These are NaN, infinite numbers and ``invalid``; of integer codes, and of ``positive`` quantities, 0 and less, too.
    """
    with np.errstate(invalid="ignore"):
        none: NDArray[np.bool_] = (
            ~(stored > 0) if positive or stored.dtype.kind in "iu" else np.zeros(stored.shape, bool)
        )
        none |= ~np.isfinite(stored)
        if invalid is not None:
            none |= stored == np.float32(invalid)
        return none


class ForeignConstant(NamedTuple):
    """A constant by which another program may mean no value; what follows, each command decides."""

    code: float  # as stored
    marked: NDArray[np.bool_]  # (H, W), the pixels that have it

    def __str__(self) -> str:
        return f"{100 * np.mean(self.marked):.3g} % of the pixels are {self.code:g}"


_MIN_CONSTANT_SHARE = 0.005  # of the pixels; a constant that fewer have may be measured
_USUAL_MARKS, _MAX_MARK = (0.0, -1.0, -16.0), -999.0  # that most pixels may have; others of most are values
_MAX_NEIGHBOR_RATIO = 0.25  # pixels up to 1 px above the constant / pixels of it; a mark is alone


def foreign_constant(
    path: Path | str, disparity: NDArray[np.float32], lowest: float = -math.inf
) -> ForeignConstant | None:
    """Return the constant at or below 0 that may mean no value in a map of another program, such as OpenCV's -1.

    It is the smallest value, from ``lowest`` on, of a share of the pixels, and few others are near it. None: there is
    no such constant, or the map is of a run of this program, which marks what has no value.
    """
    if Path(path).with_name("record.json").is_file():
        return None
    known = disparity[np.isfinite(disparity) & (disparity >= np.float32(lowest))]
    smallest = known.min(initial=np.float32(np.inf))
    n_marked = np.count_nonzero(known == smallest)
    if smallest > 0 or n_marked < _MIN_CONSTANT_SHARE * disparity.size:
        return None
    n_near = np.count_nonzero(known <= np.float32(smallest + 1)) - n_marked
    if n_near > _MAX_NEIGHBOR_RATIO * n_marked or n_marked == known.size:
        return None
    if 2 * n_marked > known.size and smallest not in _USUAL_MARKS and smallest > _MAX_MARK:
        return None
    marked = disparity == smallest
    return ForeignConstant(float(read_plane(path)[marked][0]), marked)


def scale_of(path: Path | str, scale: float | None, any_kind: bool) -> float | None:
    """Return the scale that a map is read by: one that is not of ``any_kind`` of file leaves PFM as it is."""
    return scale if any_kind or Path(path).suffix.lower() != ".pfm" else None


def read_foreign_map(
    path: Path | str, scale: float | None = None, invalid: float | None = None, says_scale: bool = False
) -> NDArray[np.float32]:
    """Return a disparity map of any program as :func:`read_disparity` does, for commands that go on with its values.

    If ``invalid`` is None, a :func:`foreign_constant` is no value, with a warning; NaN keeps it. ``says_scale`` is for
    commands that compare the map with nothing by which a wrong scale would be seen.
    """
    disparity = read_disparity(path, scale, invalid=invalid, says_scale=says_scale)
    if invalid is None and (constant := foreign_constant(path, disparity)) is not None:
        disparity[constant.marked] = np.nan
        warn(f"{shown(path)}: {constant}: taken as no value (--invalid nan keeps them)")
    return disparity


def read_disparity(
    path: Path | str,
    scale: float | None = None,
    scale_8bit: float | None = None,
    invalid: float | None = None,
    says_scale: bool = False,
) -> NDArray[np.float32]:
    """Return a disparity map, (H, W) float32, pixels, NaN = unknown.

    PFM, float npy and float TIFF are in pixels. Integer codes (PNG, PGM, integer npy) are divided by ``scale``, codes
    per pixel: None is 256 for 16-bit codes (KITTI) and ``scale_8bit`` for 8-bit codes, which have none of their own.
    There is a warning if a scale of 256 is only likely, or ``says_scale``. What is unknown, :func:`without_value` says
    of the stored numbers.
    """
    values = read_plane(path)
    codes = values.dtype.kind in "iu"
    if scale is None and codes:
        scale = scale_8bit if values.dtype.itemsize == 1 else KITTI_SCALE
        if scale is None:
            raise InputError(f"{shown(path)}: 8-bit disparities need a scale (codes per pixel); {_SAY_SCALE}")
        is_usual = values.dtype.kind + str(values.dtype.itemsize) == "u2"
        if values.dtype.itemsize > 1 and (says_scale or not is_usual):
            hint = "" if is_usual else "; OpenCV's have 16 codes per pixel"
            warn(f"{shown(path)}: {values.dtype} disparities are divided by {scale:g}, as KITTI's{hint}; {_SAY_SCALE}")
    with np.errstate(all="ignore"):  # infinite results are unknown, like infinite values
        exact = values / np.float64(scale) if codes else values.astype(np.float32) / np.float32(scale or 1)
        disparity = exact.astype(np.float32)
    disparity[without_value(values, invalid) | ~np.isfinite(disparity)] = np.nan
    width = disparity.shape[1]
    with np.errstate(invalid="ignore"):
        n_beyond = np.count_nonzero(np.abs(disparity) > width)
    if 2 * n_beyond > np.count_nonzero(~np.isnan(disparity)):
        median = np.nanmedian(disparity.astype(np.float64))  # float32 could overflow
        warn(
            f"{shown(path)}: the median disparity is {median:.4g} px, wider than the image of "
            f"{width} px; is the scale (codes per pixel) right?"
        )
    return disparity


def check_sign(name: Path | str, disparity: NDArray[np.float32], offset: float = 0.0) -> None:
    """Raise InputError where most matches of a map lie behind the cameras, ``offset`` being that of their centers."""
    known = disparity[np.isfinite(disparity)]
    if np.count_nonzero(known + np.float32(offset) < 0) > _MAX_BEHIND * known.size:
        raise InputError(
            f"{name}: most disparities are negative; they are pixels from 0 on, by which matches lie to the left in "
            "the right image: is the sign swapped?"
        )


def read_pfm(path: Path | str) -> NDArray[np.float32]:
    """Return the values of a one-channel PFM file as stored, (H, W) float32, top row first, +inf = unknown.

    A negative scale in the header means little endian, its size is ignored, as by the Middlebury SDK. Three equal
    channels are accepted; bytes behind the values are ignored with a warning, as the benchmarks' programs do.
    """
    data = read_bytes(path)
    with naming(path):
        return _decode_pfm(data, path)


def read_plane(path: Path | str) -> NDArray[Any]:
    """Return (H, W) numbers as stored: a map (PFM, npy, npz, float TIFF), codes, or the values that a plug-in reads."""
    if (plane := read_by_plugin(path)) is not None:
        return plane
    data = read_bytes(path)
    with naming(path):
        if data.startswith((NPY_MAGIC, _NPZ_MAGIC)):
            return _decode_npy(data)
        if image_kind(data) == "Pfm":
            return _decode_pfm(data, path)
        numbers = decode_numbers(data)
        return read_grey(path) if numbers is None else numbers


def map_npy(path: Path | str, dimensions: int) -> NDArray[Any]:
    """Return the array of a ``.npy`` file, mapped into memory, so that only the parts in use are read."""
    with open_regular(path), naming(path):
        try:
            array = np.load(path, mmap_mode="r", allow_pickle=False)
        except Exception as error:  # damaged headers raise many kinds
            raise InputError(f"damaged, or no .npy file ({str(error)[:200]})") from None
        return _numbers(array, dimensions)


def _decode_npy(data: bytes) -> NDArray[Any]:
    """Return the (H, W) array of a ``.npy`` file, or the map of an ``.npz`` file: its only array, or the named one."""
    try:
        stored = np.load(BytesIO(data), allow_pickle=False)
        if isinstance(stored, np.ndarray):
            return _numbers(stored, 2)
        names = stored.files if len(stored.files) == 1 else [name for name in _MAP_NAMES if name in stored.files]
        if len(names) != 1:
            raise InputError(
                f"an .npz file of {len(stored.files)} arrays ({', '.join(stored.files)[:200]}); expected one, or "
                f"one of them called {', '.join(_MAP_NAMES)}"
            )
        if (size := max(info.file_size for info in stored.zip.infolist())) > _MAX_UNPACKED_BYTES:
            raise InputError(f"too large: {size} bytes")
        return _numbers(stored[names[0]], 2)
    except InputError:
        raise
    except Exception as error:  # numpy, zipfile and zlib raise many kinds for damage, MemoryError among them
        raise InputError(f"damaged .npy or .npz file ({str(error)[:200]})") from None


def _numbers(array: NDArray[Any], dimensions: int) -> NDArray[Any]:
    if array.ndim != dimensions or array.dtype.kind not in "biuf" or not array.size:
        want = "(H, W)" if dimensions == 2 else "(H, W, D)"
        raise InputError(f"expected an {want} array of numbers, got {array.dtype} of shape {array.shape}")
    return array


def _decode_pfm(data: bytes, path: Path | str) -> NDArray[np.float32]:
    (height, width, channels), dtype, start = pfm_header(data)
    n_values = width * height * channels
    want, got = n_values * 4, len(data) - start
    if want > got:
        raise InputError(f"damaged PFM ({width} x {height} needs {want} bytes of data, the file has {got})")
    if want < got:
        warn(f"{shown(path)}: the PFM has {got - want} bytes more than its {width} x {height} values; they are ignored")
    values = np.frombuffer(data, dtype, n_values, start).reshape(height, width, channels)[::-1]
    if channels == 3 and not np.array_equal(values, np.repeat(values[..., :1], 3, axis=2), equal_nan=True):
        raise InputError("a colour PFM, expected one channel")
    plane: NDArray[np.float32] = values[..., 0].astype(np.float32, order="C")
    return plane


def write_pfm(path: Path | str, values: NDArray[np.floating[Any]]) -> None:
    """Write (H, W) float values as little-endian PFM, atomically; NaN becomes +inf (unknown)."""
    write_bytes(path, encode_pfm(values))


def encode_pfm(values: NDArray[np.floating[Any]]) -> bytes:
    """Return the bytes that :func:`write_pfm` writes."""
    if values.ndim != 2:
        raise ValueError(f"expected (H, W), got {values.shape}")
    plane = values.astype("<f4")
    plane[np.isnan(plane)] = np.inf
    header = f"Pf\n{plane.shape[1]} {plane.shape[0]}\n-1\n".encode()
    return header + plane[::-1].tobytes()


def write_disparity_png(path: Path | str, disparity: NDArray[np.floating[Any]]) -> None:
    """Write a KITTI disparity PNG: uint16, disparity x 256 within 1 to 65535, 0 = unknown, atomically."""
    write_bytes(path, encode_disparity_png(disparity))


def encode_disparity_png(disparity: NDArray[np.floating[Any]]) -> bytes:
    """Return the bytes that :func:`write_disparity_png` writes."""
    if disparity.ndim != 2:
        raise ValueError(f"expected (H, W), got {disparity.shape}")
    with np.errstate(all="ignore"):
        codes = np.clip(np.rint(disparity * KITTI_SCALE), 1, 65535)  # exact in any precision: a power of two
    return png_bytes(np.where(np.isfinite(disparity), codes, 0).astype(np.uint16))
