"""Disparity maps, masks, status maps and other maps as files: PFM, KITTI PNG, scaled 8-bit images, npy, npz."""

from __future__ import annotations

import contextlib
import math
import zlib
from collections.abc import Iterable
from io import BytesIO
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.core.maps import without_smoothed
from depthcli.io.formats.exr import read_exr
from depthcli.io.formats.files import (
    is_of_a_run,
    naming,
    open_regular,
    read_bytes,
    shown,
    warn,
    write_bytes,
    write_text,
)
from depthcli.io.formats.images import (
    NPY_MAGIC,
    decode_bits,
    decode_numbers,
    image_kind,
    pfm_header,
    png_bytes,
    read_grey,
    squeezed,
)
from depthcli.io.formats.map_format import MAP_SUFFIXES, read_by_plugin
from depthcli.show.view import MEASURED_CODE, Palette, status_words

KITTI_SCALE = 256.0
"""Codes per pixel of 16-bit disparity PNGs (KITTI, DSEC)."""

OPENCV_SCALE = 16.0
"""Codes per pixel of OpenCV's signed 16-bit disparities (``StereoSGBM``, ``StereoBM``)."""

_OF_TRUTH = "(of ground truth: disp_scale in meta.json)"
_NEGATIVE = 65520  # -16 of OpenCV, no value, as an unsigned code
_KITTI_FOLDERS = ("disp_0", "disp_1")  # of maps for KITTI's server
_MAX_BEHIND = 0.5  # largest share of negative disparities
_NPZ_MAGIC = b"PK\x03\x04"
_MAX_UNPACKED_BYTES = 1 << 30  # largest array in an .npz file; the largest images take as much
_MIDDLEBURY_MASK = (0, 128, 255)  # unknown, visible in one view, visible in both; only the last is inside
_MAP_NAMES = ("disp", "disparity", "disp_left", "depth", "arr_0")  # array to choose in an .npz file of several


def without_value(stored: NDArray[Any], invalid: float | None = None, positive: bool = False) -> NDArray[np.bool_]:
    """Return a mask of the numbers in a map that mean no value.

    These are NaN, infinite numbers and ``invalid``. For integer codes and ``positive`` quantities, 0 and negative
    numbers mean no value, too.
    """
    with np.errstate(invalid="ignore"):
        none: NDArray[np.bool_] = (
            ~(stored > 0) if positive or stored.dtype.kind in "iu" else np.zeros(stored.shape, bool)
        )
        none |= ~np.isfinite(stored)
        if invalid is not None:
            none |= is_mark(stored, invalid)
        return none


def is_mark(stored: NDArray[Any], invalid: float) -> NDArray[np.bool_]:
    """Return a mask of the numbers equal to ``invalid``, which is rounded to their dtype."""
    with np.errstate(over="ignore"):
        mark = stored.dtype.type(invalid) if stored.dtype.kind == "f" else invalid
    return np.asarray(stored == mark)


_MIN_CONSTANT_SHARE = 0.005  # smallest share of pixels; a rarer constant may be measured
# Only these constants, or any of at most _MAX_MARK, may mark most pixels; other constants of most pixels are values.
_COMMON_MARKS, _MAX_MARK = (0.0, -1.0, -16.0), -999.0
_MAX_NEIGHBOR_RATIO = 0.25  # pixels up to 1 px above the constant / pixels with it; a mark is isolated
_MIN_FAR_RATIO = 4.0  # constant beyond the image width / next value; a mark is far from values
_MAX_MARKS = 4  # constants per map


def without_constants(path: Path | str, disparity: NDArray[np.float32], is_truth: bool = False) -> NDArray[np.float32]:
    """Return a map with NaN for constants that mean no value in other programs' maps: OpenCV's -1, -9999, or 1e6.

    These are the smallest value, if it is at most 0, frequent and isolated, the largest code of integers, if it is
    frequent and isolated, and values of several pixels that exceed the image width and are far from all others. Maps of
    this program's runs have no such constants. Each causes a warning. The constant 0 of ground truth is kept, since the
    truth may be infinitely far.
    """
    if is_of_a_run(path):
        return disparity
    left, marks = disparity[np.isfinite(disparity)], list[np.float32]()
    while len(marks) < _MAX_MARKS and (mark := _mark_of(left, disparity.shape)) is not None:
        marks.append(mark)
        left = left[left != mark]
    clean, stored = disparity, cast(NDArray[Any], disparity)
    largest = left.max(initial=-np.inf)
    is_apart = _is_isolated(left, largest, disparity.size)
    if marks or is_apart:
        with contextlib.suppress(InputError):  # e.g. disparities packed into colors have no single code
            stored = read_plane(path)
    if is_apart and stored.dtype.kind in "iu" and (stored[disparity == largest] == np.iinfo(stored.dtype).max).any():
        marks.append(largest)
    for mark in marks:
        marked = disparity == mark
        code = float(stored[marked][0])
        constant = f"{shown(path)}: {100 * np.mean(marked):.3g} % of the pixels are {code:g}"
        if is_truth and code == 0:
            warn(f"{constant}, which count as true disparities (--invalid 0 if they are unknown)")
            continue
        clean = np.where(marked, np.float32(np.nan), clean)
        warn(f"{constant}: taken as {'unknown truth' if is_truth else 'no value'} (--invalid nan keeps them)")
    return clean


def far_constant(known: NDArray[np.float32], least: float) -> np.float32 | None:
    """Return the value of several pixels that is beyond ``least`` and far beyond all other values; or None."""
    for far in (known.min, known.max) if known.size else ():
        mark = far()
        others = known[known != mark]
        if abs(mark) > least and known.size - others.size > 1 and others.size:
            nearest = np.abs(others[np.sign(others) == np.sign(mark)]).max(initial=np.float32(0))
            if abs(float(mark)) > _MIN_FAR_RATIO * float(nearest):
                return np.float32(mark)
    return None


def _mark_of(known: NDArray[np.float32], shape: tuple[int, ...]) -> np.float32 | None:
    """Return the value of a map that probably means no value: a far one, or a frequent smallest one; or None."""
    if (far := far_constant(known, shape[1])) is not None:
        return far
    for some in (known, known[known >= 0]):
        smallest = some.min(initial=np.float32(np.inf))
        n_marked = np.count_nonzero(some == smallest)
        is_common = 2 * n_marked <= some.size or smallest in _COMMON_MARKS or smallest <= _MAX_MARK
        if smallest <= 0 and is_common and _is_isolated(some, smallest, math.prod(shape)):
            return np.float32(smallest)
    return None


def _is_isolated(known: NDArray[np.float32], end: np.float32, n_pixels: int) -> bool:
    """Return whether a frequent value, the smallest or the largest, has few others within a pixel of it."""
    n_marked = np.count_nonzero(known == end)
    if n_marked < _MIN_CONSTANT_SHARE * n_pixels or n_marked == known.size:
        return False
    n_near = np.count_nonzero(np.abs(known - end) <= 1) - n_marked
    return bool(n_near <= _MAX_NEIGHBOR_RATIO * n_marked)


class ScaleError(InputError):
    """Raised for unsigned 16-bit disparities of unknown scale, which may be KITTI's, OpenCV's or others."""


def _has_kitti_scale(path: Path | str) -> bool:
    """Return whether a map is of a run of this program, or in a folder for KITTI's server."""
    return is_of_a_run(path) or Path(path).parent.name in _KITTI_FOLDERS


def scale_of(path: Path | str, scale: float | None, any_kind: bool) -> float | None:
    """Return the scale for reading a map: None for PFM, unless the scale applies to ``any_kind`` of file."""
    return scale if any_kind or Path(path).suffix.lower() != ".pfm" else None


def read_foreign_map(
    path: Path | str,
    scale: float | None = None,
    invalid: float | None = None,
    scale_8bit: float | None = None,
    is_kitti: bool = False,
) -> NDArray[np.float32]:
    """Return a disparity map of any program as :func:`read_disparity` does; all commands read maps with this function.

    If ``invalid`` is None, :func:`without_constants` is applied; NaN keeps all values. Unsigned 16-bit codes have
    KITTI's scale if ``is_kitti``; otherwise ``asks`` is set.
    """
    disparity = read_disparity(path, scale, scale_8bit, invalid, not is_kitti)
    return without_constants(path, disparity) if invalid is None else disparity


def known_truth(path: Path | str, disparity: NDArray[np.float32], invalid: float | None = None) -> NDArray[np.float32]:
    """Return ground truth, (H, W) pixels, with NaN for pixels equal to ``invalid``, or :func:`without_constants`."""
    if invalid is None:
        return without_constants(path, disparity, is_truth=True)
    stored = disparity
    with contextlib.suppress(InputError):  # e.g. disparities packed into colors
        stored = read_plane(path)
    return np.where(is_mark(stored, invalid), np.float32(np.nan), disparity)


def read_disparity(
    path: Path | str,
    scale: float | None = None,
    scale_8bit: float | None = None,
    invalid: float | None = None,
    asks: bool = False,
) -> NDArray[np.float32]:
    """Return a disparity map, (H, W) float32, pixels, NaN = unknown.

    PFM, float npy and float TIFF are in pixels, unless ``scale`` is given. Integer codes (PNG, PGM, integer npy) are
    divided by ``scale``, codes per pixel. Its default is 256 for unsigned 16-bit codes (KITTI); if ``asks``, they must
    be of a run, in a folder for KITTI's server or, with a warning, too large for OpenCV's scale (else ScaleError). It
    is 16 for signed ones (OpenCV), with a warning, and ``scale_8bit`` for 8-bit codes. Raise InputError for other
    integers without a scale.
    :func:`without_value` defines which stored numbers are unknown.
    """
    values = read_plane(path)
    if values.dtype.kind == "b":
        raise InputError(f"{shown(path)}: true or false, expected disparities")
    codes = values.dtype.kind in "iu"
    if scale is None and codes:
        scale = _usual_scale(path, values, scale_8bit, asks)
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


def _usual_scale(path: Path | str, values: NDArray[Any], scale_8bit: float | None, asks: bool) -> float:
    """Return the scale of integer codes that :func:`read_disparity` assumes, with its warnings and errors."""
    kind, name = values.dtype.str[1:], shown(path)
    top = int(values.max(initial=0, where=values < _NEGATIVE)) if kind == "u2" else 0
    if asks and top and not _has_kitti_scale(path):
        if top <= OPENCV_SCALE * values.shape[1]:
            raise ScaleError(
                f"{name}: uint16 disparities of unknown scale: the largest code, {top}, is {top / KITTI_SCALE:.4g} "
                f"px in KITTI's files (--scale 256), {top / OPENCV_SCALE:.4g} px in OpenCV's (--scale 16) "
                f"{_OF_TRUTH}; or store pixels, as PFM"
            )
        # With 16 codes per pixel, it would be wider than the image.
        warn(f"{name}: uint16 disparities are divided by 256, as KITTI's; --scale gives another {_OF_TRUTH}")
    if kind == "i2":
        warn(f"{name}: int16 disparities are divided by 16, as OpenCV's; --scale gives another {_OF_TRUTH}")
    scale = {"u1": scale_8bit, "u2": KITTI_SCALE, "i2": OPENCV_SCALE}.get(kind)
    if scale is None:
        bits = "8-bit" if values.itemsize == 1 else values.dtype
        raise InputError(f"{name}: {bits} disparities need a scale (codes per pixel): --scale {_OF_TRUTH}")
    return scale


def check_sign(name: Path | str, disparity: NDArray[np.float32], offset: float = 0.0) -> None:
    """Raise InputError if most disparities of a map, plus the ``offset`` of the cameras' centers, are negative."""
    known = disparity[np.isfinite(disparity)]
    if np.count_nonzero(known + np.float32(offset) < 0) > _MAX_BEHIND * known.size:
        raise InputError(
            f"{name}: most disparities are negative; they are pixels from 0 on, by which matches lie to the left in "
            "the right image: is the sign swapped?"
        )


def read_pfm(path: Path | str) -> NDArray[np.float32]:
    """Return the values of a one-channel PFM file as stored, (H, W) float32, top row first, +inf = unknown.

    A negative scale in the header means little endian; its size is ignored, as in the Middlebury SDK. Three equal
    channels are accepted. Bytes after the values are ignored with a warning; the benchmarks' programs ignore them, too.
    """
    data = read_bytes(path)
    with naming(path):
        return _decode_pfm(data, path)


def read_plane(path: Path | str) -> NDArray[Any]:
    """Return (H, W) numbers as stored: a map (PFM, npy, npz, float TIFF), codes, or a plug-in's values."""
    if Path(path).suffix.lower() not in MAP_SUFFIXES and (plane := read_by_plugin(path)) is not None:
        return plane
    data = read_bytes(path)
    with naming(path):
        if data.startswith((NPY_MAGIC, _NPZ_MAGIC)):
            return _decode_npy(data, path)
        if (kind := image_kind(data)) == "Exr":
            return read_exr(path)
        if kind == "Pfm":
            return _decode_pfm(data, path)
        numbers = decode_numbers(data) if kind == "Tiff" else None
        return read_grey(path) if numbers is None else numbers


def read_mask(path: Path | str) -> NDArray[np.bool_]:
    """Return an (H, W) mask, True above half of its largest value. It may be 0/255, 0/1, 0/128 or bool.

    Other values, as in a JPEG or a label map, cause a warning, except for Middlebury's masks.
    """
    values = read_plane(path)
    if not np.isfinite(values).all() or values.min() < 0:
        raise InputError(f"{shown(path)}: values that are negative or no numbers; expected a mask, 0 outside")
    top = values.max()
    inside: NDArray[np.bool_] = 2.0 * values > float(top) + (top > 2)  # 128 is half of 255
    other = (values != 0) & (values != top)
    if other.any() and not (values.dtype == np.uint8 and np.isin(values, _MIDDLEBURY_MASK).all()):
        share = 100 * np.mean(other)
        warn(f"{shown(path)}: {share:.3g} % of the pixels are neither 0 nor {top:g}; above half of that is inside")
    return inside


def read_filled_mask(path: Path | str) -> NDArray[np.bool_]:
    """Return a mask as :func:`read_mask` does. Raise InputError if no pixel is inside."""
    inside = read_mask(path)
    if not inside.any():
        raise InputError(f"{shown(path)}: no pixel is inside the mask; expected 0 outside and 255 inside")
    return inside


def map_npy(path: Path | str) -> NDArray[Any]:
    """Return the memory-mapped (H, W, D) array of a ``.npy`` file; only the parts in use are read."""
    with open_regular(path), naming(path):
        try:
            array = np.load(path, mmap_mode="r", allow_pickle=False)
        except Exception as error:  # damaged headers raise many kinds
            raise InputError(f"damaged, or no .npy file ({str(error)[:200]})") from None
        return _numbers(array, 3)


def _decode_npy(data: bytes, path: Path | str) -> NDArray[Any]:
    """Return the (H, W) array of a ``.npy`` file, or of an ``.npz`` file: its only array, or one in ``_MAP_NAMES``."""
    try:
        file = BytesIO(data)
        stored = np.load(file, allow_pickle=False)
        if isinstance(stored, np.ndarray):
            if rest := len(data) - file.tell():
                warn(f"{shown(path)}: {rest} bytes follow its array; they are ignored")
            return _numbers(stored, 2)
        names = stored.files if len(stored.files) == 1 else [name for name in _MAP_NAMES if name in stored.files]
        if len(names) != 1:
            raise InputError(
                f"an .npz file of {len(stored.files)} arrays ({', '.join(stored.files)[:200]}); expected one, or "
                f"one of them called {', '.join(_MAP_NAMES)}"
            )
        if (size := max(info.file_size for info in stored.zip.infolist())) > _MAX_UNPACKED_BYTES:
            raise InputError(f"too large: {size} bytes")
        if others := [name for name in stored.files if name != names[0] and stored[name].ndim > 1]:
            warn(f"{shown(path)}: its array {names[0]!r} is read, not {', '.join(others)[:200]}")
        return _numbers(stored[names[0]], 2)
    except InputError:
        raise
    except Exception as error:  # numpy, zipfile and zlib raise many kinds for damage, MemoryError among them
        raise InputError(f"damaged .npy or .npz file ({str(error)[:200]})") from None


def _numbers(array: NDArray[Any], dimensions: int) -> NDArray[Any]:
    array = squeezed(array, dimensions)
    if array.ndim != dimensions or array.dtype.kind not in "biuf" or not array.size:
        expected = "(H, W)" if dimensions == 2 else "(H, W, D)"
        raise InputError(f"expected an {expected} array of numbers, got {array.dtype} of shape {array.shape}")
    return array


def _decode_pfm(data: bytes, path: Path | str) -> NDArray[np.float32]:
    """Return the (H, W) values of a PFM file. Raise InputError if it is damaged or has colors."""
    (height, width, channels), dtype, start = pfm_header(data)
    n_values = width * height * channels
    needed, got = n_values * 4, len(data) - start
    if needed > got:
        raise InputError(f"damaged PFM ({width} x {height} needs {needed} bytes of data, the file has {got})")
    if needed < got:
        warn(
            f"{shown(path)}: the PFM has {got - needed} bytes more than its {width} x {height} values; they are ignored"
        )
    values = np.frombuffer(data, dtype, n_values, start).reshape(height, width, channels)[::-1]
    if channels == 3 and not np.array_equal(values, np.repeat(values[..., :1], 3, axis=2), equal_nan=True):
        raise InputError("a color PFM, expected one channel")
    plane: NDArray[np.float32] = values[..., 0].astype(np.float32, order="C")
    return plane


def write_pfm(path: Path | str, values: NDArray[np.floating[Any]]) -> None:
    """Write (H, W) floats atomically as little-endian PFM; NaN becomes +inf (unknown)."""
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
    """Write a KITTI disparity PNG atomically: uint16, disparity x 256, clipped to 1 to 65535; 0 = unknown."""
    write_bytes(path, encode_disparity_png(disparity))


def encode_disparity_png(disparity: NDArray[np.floating[Any]]) -> bytes:
    """Return the bytes that :func:`write_disparity_png` writes."""
    if disparity.ndim != 2:
        raise ValueError(f"expected (H, W), got {disparity.shape}")
    with np.errstate(all="ignore"):
        codes = np.clip(np.rint(disparity * KITTI_SCALE), 1, 65535)  # exact in any precision: a power of two
    return png_bytes(np.where(np.isfinite(disparity), codes, 0).astype(np.uint16))


class StatusMap(np.ndarray[Any, np.dtype[np.uint8]]):
    """(H, W) uint8: the codes of a status map, bits of ``Status`` or ``DepthStatus``."""

    @property
    def measured(self) -> NDArray[np.bool_]:
        """(H, W) bool, True for measured pixels (code 0)."""
        measured: NDArray[np.bool_] = np.asarray(self) == 0
        return measured


def write_status(path: Path | str, status: NDArray[np.uint8]) -> None:
    """Write (H, W) uint8 codes as a one-channel 8-bit PNG for :func:`read_status`."""
    from PIL import Image

    if status.ndim != 2 or status.dtype != np.uint8:
        raise ValueError(f"expected (H, W) uint8, got {status.shape} {status.dtype}")
    file = BytesIO()
    picture = Image.frombytes("L", status.shape[::-1], np.ascontiguousarray(status).tobytes())
    # For these files of few codes, run lengths compress as well as a search for repetitions, in 1/7 of the time.
    picture.save(file, "PNG", compress_level=1, compress_type=zlib.Z_RLE)
    write_bytes(path, file.getvalue())


def read_status(path: Path | str) -> StatusMap:
    """Return the codes of ``status.png``, (H, W) uint8, with ``measured``. Raise InputError if it cannot be read.

    Files of versions up to 0.2.0 have a palette and bit 32, "smoothed", which is removed.

    Examples
    --------
    >>> import depthcli
    >>> depthcli.read_status("run/scene/status.png").measured.mean()  # doctest: +SKIP
    """
    data = read_bytes(path)
    with naming(path):
        return without_smoothed(decode_bits(data)).view(StatusMap)


def write_codes(path: Path | str, palette: Palette, values: Iterable[int] | None = None) -> None:
    """Write the text that explains the codes of status maps; the default ``values`` are 0 and each single bit."""
    codes = sorted(set(palette if values is None else map(int, values)))
    rows = [f"{code:3d}  {status_words(code, palette)}" for code in codes]
    write_text(path, "\n".join(["Codes of status.png, sums of bits:", *rows, "", MEASURED_CODE, ""]))
