"""Images as files: PNG, JPEG, Netpbm, TIFF, BMP; single images and pairs.

OpenCV decodes 16-bit color, 16-bit PNG and floating-point TIFF, which Pillow cannot. Pillow decodes the rest.
"""

from __future__ import annotations

import contextlib
import importlib
import logging
import re
import struct
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.core.frames import Image as Image
from depthcli.core.frames import StereoPair, color8, luma
from depthcli.io.formats.exr import EXR_MAGIC, exr_sizes
from depthcli.io.formats.files import naming, open_regular, read_bytes, shown, warn, write_bytes

if TYPE_CHECKING:
    from PIL.ImageFile import ImageFile

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".ppm", ".pgm", ".pnm", ".tif", ".tiff", ".bmp")
"""Endings of images in scene folders, best known first."""

NPY_MAGIC = b"\x93NUMPY"

_KINDS = {
    "Png": (b"\x89PNG\r\n\x1a\n",),
    "Jpeg": (b"\xff\xd8",),
    "Pnm": (b"P2", b"P3", b"P5", b"P6"),
    "Tiff": (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"),
    "Bmp": (b"BM",),
    "Pfm": (b"Pf", b"PF"),
    "Npy": (NPY_MAGIC,),
    "Exr": (EXR_MAGIC,),
}
_PNM_HEADER = re.compile(rb"P\d(?:\s|#[^\n]*\n)+" + rb"(\d{1,9})(?:\s|#[^\n]*\n)+" * 2 + rb"(\d{1,9})\s")
# Some programs write comment lines between the numbers.
_PFM_GAP = rb"\s+(?:#[^\n]*\n\s*)*"
_PFM_HEADER = re.compile(rb"(P[fF])" + (_PFM_GAP + rb"(\d{1,9})") * 2 + _PFM_GAP + rb"([-+0-9.eE]{1,40})(?:\r\n|\s)")
_HEADER_BYTES = 1 << 14  # start of a file; it nearly always contains the image's size
_MAX_DECODED_BYTES = 1 << 30
# Decoded bytes per stored byte: 12 bits of LZW expand to up to 4 KiB, a byte of deflate to 1 KiB, of JPEG to 1.5 KiB.
_MAX_EXPANSION = 3000
_MAX_TEXT_BYTES = 1 << 25  # largest plain PGM or PPM; reading takes 50 bytes per number
_WIDTH, _HEIGHT, _BITS, _SAMPLES, _TILES, _FORMAT, _FLOATS = 256, 257, 258, 277, (322, 323), 339, 3  # tags of TIFF
_PHOTOMETRIC, _PLANAR, _SUBFILE, _EXTRA = 262, 284, 254, 338  # further tags of TIFF
_SIGNED, _SEPARATE, _MIN_IS_WHITE, _RGB = 2, 2, 0, 2  # values of the tags
# Of the mean samples of two 16-bit views: another number of bits is a factor of 4 at least, other exposures are less.
_MAX_BRIGHTER = 3.0
_PART_OF_PAGE = 5  # bits of _SUBFILE: a page of lower resolution, or a mask of another page
_MAX_PAGES = 10_000  # TIFF pages to count
_ORIENTATION = 274  # tag of TIFF and EXIF: the turn or reflection that makes the stored image upright
_TURNS: dict[int, Callable[[NDArray[Any]], NDArray[Any]]] = {
    2: lambda image: image[:, ::-1],
    3: lambda image: image[::-1, ::-1],
    4: lambda image: image[::-1],
    5: lambda image: image.swapaxes(0, 1),
    6: lambda image: np.rot90(image, -1),
    7: lambda image: image[::-1, ::-1].swapaxes(0, 1),
    8: lambda image: np.rot90(image),
}


def read_image(path: Path | str) -> Image:
    """Return an image, (H, W) grey or (H, W, 3) RGB, uint8 or uint16; the format is recognized by the content.

    Transparency is dropped, palettes are resolved, and the EXIF orientation is applied with a warning.
    """
    return _read(path)[0]


def _read(path: Path | str) -> tuple[Image, bytes]:
    data = read_bytes(path)
    with naming(path):
        pixels, turn = _decoded(data)
    if turn:
        warn(f"{shown(path)}: turned upright, as its EXIF orientation says ({turn})")
    for text in (_left_over(data), _looks_raw(pixels)):
        if text:
            warn(f"{shown(path)}: {text}")
    return pixels, data


def read_two_frames(path: Path | str) -> tuple[Image, Image]:
    """Return the two images of an MPO file, as 3-D cameras write it: the left view first."""
    data = read_bytes(path)
    with naming(path), _decoding("Jpeg"):
        from PIL import Image as Pillow

        with Pillow.open(BytesIO(data)) as file:
            count = int(getattr(file, "n_frames", 1))
            if count < 2:
                raise InputError("holds one image; an MPO file of two views, or --halves, is needed")
            frames = []
            for number in (0, 1):
                file.seek(number)
                frames.append(np.asarray(file.convert("RGB"), np.uint8))
        if count > 2:
            warn(f"{shown(path)}: holds {count} images; the first two are the views")
    return frames[0], frames[1]


def read_color8(path: Path | str) -> NDArray[np.uint8]:
    """Return any image as (H, W, 3) uint8 RGB; 16-bit samples are scaled by the number of bits in use."""
    image, data = _read(path)
    with naming(path):
        bits = bits_said((image,), path, _declared_bits(data))
    return color8(image, bits)


def read_grey(path: Path | str) -> Image:
    """Return an image of codes (disparities, a mask), (H, W) uint8 or uint16; it may have three equal channels."""
    data = read_bytes(path)
    with naming(path):
        pixels, _ = _decoded(data)
        if image_kind(data) == "Tiff" and _check_tiff(data).photometric == _MIN_IS_WHITE:
            # Programs disagree on whether such codes are meant as stored.
            raise InputError("a TIFF of codes in which 0 is white; store it as PNG, or with 0 black (MinIsBlack)")
        if pixels.ndim == 3 and not (pixels == pixels[..., :1]).all():
            raise InputError("a color image, expected one channel of codes")
    if text := _left_over(data):
        warn(f"{shown(path)}: {text}")
    return pixels if pixels.ndim == 2 else cast(Image, np.ascontiguousarray(pixels[..., 0]))


def _decoded(data: bytes) -> tuple[Image, int]:
    """Return the upright image and its stored EXIF orientation, 0 if it was upright."""
    kind, turn = image_kind(data), 0
    if kind in ("Pfm", "Npy", "Exr"):
        raise InputError(f"a map of numbers ({kind.lower()}), expected an image")
    if kind == "Pnm":
        return _decode_pnm(data), turn
    header = _check_tiff(data) if kind == "Tiff" else None
    if header is not None:
        header.check_image()
    with _decoding(kind):
        if header is not None and not header.is_common:
            pixels, turn = _with_tifffile(data, header), header.turn
        else:
            pixels, turn = _with_libraries(data, kind, header)
    if turn:
        pixels = _TURNS[turn](pixels)
    return cast(Image, np.ascontiguousarray(pixels, np.uint8 if pixels.dtype.itemsize == 1 else np.uint16)), turn


def _with_libraries(data: bytes, kind: str, header: _TiffHeader | None) -> tuple[NDArray[Any], int]:
    """Return samples as stored by Pillow, or by OpenCV for 16-bit color and PNG, and the EXIF orientation or 0."""
    image = _opened(BytesIO(data), kind)
    if getattr(image, "n_frames", 1) > 1 and kind == "Png":
        raise InputError(f"an animation of {image.n_frames} frames, expected one image")  # type: ignore[attr-defined]
    if (turn := _orientation(image)) and kind == "Tiff":
        # Pillow and OpenCV turn a TIFF wrongly if width and height change places, so that the tag is set to 1.
        order = "<" if data.startswith(b"II") else ">"
        entry, upright = (struct.pack(f"{order}HHIHH", _ORIENTATION, 3, 1, k, 0) for k in (turn, 1))
        data = data.replace(entry, upright, 1)
        image = _opened(BytesIO(data), kind)
    size, mode, bands = (image.height, image.width), image.mode, len(image.getbands())
    is_wide = ";16" in str(image.tile[0][3]) and (kind == "Png" or not image.mode.startswith("I;16"))
    _check_size(*size, bands * (2 if is_wide else 1), len(data))
    if is_wide:
        pixels = _with_opencv(data)
        if pixels.ndim == 3:  # OpenCV returns grey with transparency as color
            pixels = pixels[..., 0] if mode in ("LA", "La", "I;16") else pixels[..., 2::-1]
    else:  # copy, since numba compiles kernels again for read-only arrays
        is_plain = mode in ("L", "RGB") or mode.startswith("I;16")
        pixels = np.array(image if is_plain else image.convert("L" if mode in ("1", "LA", "La") else "RGB"))
    is_deep = is_wide or mode.startswith("I") if header is None else header.bits > 8
    _check_decoded(pixels, size, 1 if bands <= 2 and mode != "P" else 3, 16 if is_deep else 8)
    return pixels, turn


def _check_decoded(pixels: NDArray[Any], size: tuple[int, int], channels: int, bits: int) -> None:
    """Raise InputError if a decoder's array differs from the file's header in size, channels or bits."""
    shape = (*size, *((channels,) if channels > 1 else ()))
    if pixels.shape != shape or pixels.dtype.itemsize != bits // 8:
        got, expected = (" x ".join(map(str, each)) for each in (pixels.shape, shape))
        raise InputError(
            f"decoded as {got} {pixels.dtype}, but its header is of {expected} with {bits} bit; store it as an "
            "8- or 16-bit PNG, grey or RGB"
        )


def _left_over(data: bytes) -> str:
    """Return a warning about content of a file besides the image that is read, or an empty text."""
    kind = image_kind(data)
    if kind == "Pnm" and data[:2] in (b"P5", b"P6"):
        (height, width, channels), top, start = pnm_header(data)
        rest = data[start + height * width * channels * (2 if top > 255 else 1) :]
        return f"{len(rest)} bytes follow its image; they are ignored" if rest.strip() else ""
    if kind == "Tiff" and _tiff_tags(BytesIO(data)).get(_EXTRA, ())[:1] == (0,):
        return "a further channel of unknown meaning is left out"
    if kind != "Jpeg" or b"MPF\0" not in data[: 1 << 16]:
        return ""
    from PIL.MpoImagePlugin import MpoImageFile

    with contextlib.suppress(Exception):  # a damaged index does not affect the first image
        image = MpoImageFile(BytesIO(data))
        first, n_same = image.size, 0
        for number in range(1, image.n_frames):
            image.seek(number)
            n_same += image.size == first  # smaller images are previews and gain maps
        return f"has {n_same + 1} images of one size (MPO); only the first is read" if n_same else ""
    return ""


_MIN_MOSAIC = 64  # smallest width and height of an image to test for a mosaic, pixels
_MOSAIC_RATIO = 1.3  # mean step between neighbors / between pixels two apart; images and noise have 0.4 to 1
_MOSAIC_LINES = 200  # rows and columns to test


def _looks_raw(image: Image) -> str:
    """Return a warning if a grey image looks like a Bayer mosaic, with a period of two pixels along both axes."""
    if image.ndim != 2 or min(image.shape) < _MIN_MOSAIC:
        return ""
    for lines in (image, image.T):
        some = lines[:: max(1, len(lines) // _MOSAIC_LINES)].astype(np.int32)
        near, same = (float(np.abs(some[:, k:] - some[:, :-k]).mean()) for k in (1, 2))
        if near <= _MOSAIC_RATIO * same:
            return ""
    return "neighboring pixels differ more than those two apart: a raw Bayer mosaic? demosaic it to color or grey first"


def _orientation(image: ImageFile) -> int:
    """Return the EXIF orientation of an image, a key of ``_TURNS``; 0 if it is upright or has none."""
    with contextlib.suppress(Exception):  # damaged EXIF data raise many kinds of errors, but do not affect pixels
        if "exif" in image.info or image.format == "TIFF":  # getexif would decode a PNG without EXIF data
            turn = int(image.getexif().get(_ORIENTATION, 1))
            return turn if turn in _TURNS else 0
    return 0


def decode_bits(data: bytes) -> NDArray[np.uint8]:
    """Return the (H, W) values, or palette indices, of a one-channel 8-bit PNG."""
    if image_kind(data) != "Png":
        raise InputError("expected a PNG of status bits")
    with _decoding("Png"):
        image = _opened(BytesIO(data), "Png")
        _check_size(image.height, image.width, 1, len(data))
        if image.mode not in ("P", "L"):
            raise InputError("expected a PNG of status bits, one channel of 8 bit")
        return np.array(image, np.uint8)


def decode_numbers(data: bytes) -> NDArray[Any] | None:
    """Return the (H, W) numbers of a one-channel TIFF if they are floating-point, signed or longer than 16 bit.

    float64 becomes float32, infinite beyond its range. Return None for images of 8 or 16 bit.
    """
    header = _check_tiff(data)
    if header.is_image:
        return None
    header.check_numbers()
    with _decoding("Tiff"):
        if header.code not in ("f4", "f8", "i2", "i4"):
            pixels = _with_tifffile(data, header)
        else:
            pixels = _with_opencv(data)  # Pillow cannot read 64-bit numbers and swaps some bytes twice
    if pixels.dtype.newbyteorder("=") != np.dtype(header.code):
        raise InputError(f"decoded as {pixels.dtype}, but its header says {header.words}")
    _check_decoded(pixels, header.size if header.turn < 5 else header.size[::-1], 1, header.bits)
    with np.errstate(over="ignore"):
        return pixels.astype(np.float32 if header.code == "f8" else pixels.dtype.newbyteorder("="))


def write_drawn(path: Path, paint: Callable[[], NDArray[Any] | None]) -> None:
    """Write the picture that ``paint`` returns, if any. Warn on failure, since results do not depend on pictures."""
    try:
        picture = paint()
    except Exception as error:
        warn(f"{path.name}: not written, as it cannot be drawn ({type(error).__name__}: {str(error)[:160]})")
    else:
        if picture is not None:
            write_png(path, picture)


def image_size(path: Path | str) -> tuple[int, int]:
    """Return height and width of an image or map from its header, without decoding it."""
    with open_regular(path) as file, naming(path):
        data = file.read(_HEADER_BYTES)
        kind = image_kind(data)
        file.seek(0)
        if kind in ("Pnm", "Pfm"):
            return (pnm_header if kind == "Pnm" else pfm_header)(data)[0][:2]
        if kind == "Exr":
            return exr_sizes(path)[0]
        with _decoding(kind):
            if kind == "Npy":
                shape = squeezed(np.load(path, mmap_mode="r"), 2).shape
                return shape[0], shape[1]
            if kind == "Tiff":
                tags = _tiff_tags(file)
                size, turn = (int(tags[_HEIGHT]), int(tags[_WIDTH])), int(tags.get(_ORIENTATION, 1))
            else:
                image = _opened(file, kind, verify=False)
                size, turn = (image.height, image.width), _orientation(image)
            return size if turn < 5 else size[::-1]


def squeezed(array: NDArray[Any], dimensions: int) -> NDArray[Any]:
    """Return an array reduced to ``dimensions``, if possible, by removing first or last axes of length 1."""
    while array.ndim > dimensions and 1 in (array.shape[0], array.shape[-1]):
        array = array[0] if array.shape[0] == 1 else array[..., 0]
    return array


def write_png(path: Path | str, array: NDArray[Any]) -> None:
    """Write an image atomically as :func:`png_bytes` encodes it. Raise OutputError on failure."""
    write_bytes(path, png_bytes(array))


def png_bytes(array: NDArray[Any]) -> bytes:
    """Return the PNG of (H, W) grey or (H, W, 3) RGB, uint8, uint16 or bool (as 0 and 255); otherwise ValueError."""
    if array.dtype == np.bool_:
        array = array.astype(np.uint8) * np.uint8(255)
    if array.dtype not in (np.uint8, np.uint16) or not (array.ndim == 2 or (array.ndim == 3 and array.shape[2] == 3)):
        raise ValueError(f"expected (H, W) or (H, W, 3) uint8 or uint16, got {array.shape} {array.dtype}")
    pixels = np.ascontiguousarray(array)
    done, code = cv2.imencode(".png", pixels if array.ndim == 2 else cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR))
    if not done:
        raise ValueError(f"{array.shape} {array.dtype} cannot be encoded as PNG")
    return code.tobytes()


def read_pair(left: Path | str, right: Path | str) -> StereoPair:
    """Return a rectified pair; the range of 10- or 12-bit samples in 16-bit files is declared there or estimated."""
    images, declared = [], []
    for path in (left, right):
        image, data = _read(path)
        images.append(image)
        with naming(path):
            declared.append(_declared_bits(data))
    bits = declared[0] if declared[0] == declared[1] else None
    return pair_of(images[0], images[1], (Path(left), Path(right)), bits)


def pair_of(left: Image, right: Image, paths: tuple[Path, Path], declared: int | None = None) -> StereoPair:
    """Return two images as a pair, both grey if one is; ``declared`` is the bits per sample in the files' headers.

    Raise InputError if their sizes or dtypes differ. Warn if one of two 16-bit images is several times as bright as the
    other, which happens if the files use different numbers of bits.
    """
    if left.shape[:2] != right.shape[:2] or left.dtype != right.dtype:
        first, second = (
            f"{image.shape[1]} x {image.shape[0]} {'grey' if image.ndim == 2 else 'color'} {image.dtype}"
            for image in (left, right)
        )
        raise InputError(f"{shown(paths[1])}: {second}, but {shown(paths[0].name)} is {first}; the pair must agree")
    bits = bits_said((left, right), paths[0], declared)
    if left.itemsize > 1:
        means = [float(image.mean()) for image in (left, right)]
        if max(means) > _MAX_BRIGHTER * min(means):
            other = f"{means[0]:.4g} in {shown(paths[0].name)}: do both files use the same number of bits?"
            warn(f"{shown(paths[1])}: the mean sample is {means[1]:.4g}, and {other}")
    if bits <= 8 < 8 * left.itemsize and declared is None:
        left, right = left.astype(np.uint8), right.astype(np.uint8)
    if left.ndim != right.ndim:
        # Luma keeps the number of bits, so that both images have the same grey scale.
        left, right = luma(left), luma(right)
    return StereoPair(left, right, bits)


def bits_said(images: Sequence[Image], path: Path | str, declared: int | None = None) -> int:
    """Return the bits per sample: the first of ``declared``, 8, 10, 12 and 16 that fits the largest sample.

    Warn if a 16-bit file has 8-bit samples.
    """
    if images[0].dtype == np.uint8:
        return 8
    top = max(int(image.max()) for image in images)
    bits = next((bits for bits in (declared or 0, 8, 10, 12) if bits <= 16 and top < 1 << bits), 16)
    if bits == 8 and declared is None:
        warn(f"{shown(path)}: a 16-bit file with samples up to {top}: taken as 8-bit ones")
    return bits


def _declared_bits(data: bytes) -> int | None:
    """Return the bits per sample from a PNG's sBIT or a PNM's maximum, or None."""
    kind = image_kind(data)
    if kind == "Png" and (at := data.find(b"sBIT", 0, max(data.find(b"IDAT"), 0))) > 0:
        return max(data[at + 4 : at + 4 + data[at - 1]], default=0) or None
    top = pnm_header(data)[1] if kind == "Pnm" else 255
    return None if top in (255, 65535) else top.bit_length()  # most programs write these maxima for any camera


def image_kind(data: bytes) -> str:
    """Return the format of a file that begins with ``data``, a key of ``_KINDS``. Raise InputError if unknown."""
    for kind, magics in _KINDS.items():
        if data.startswith(magics):
            return kind
    raise InputError(
        "not a PNG, JPEG, PGM, PPM, TIFF or BMP image, nor a PFM, npy or EXR map" if data else "empty file"
    )


def pnm_header(data: bytes) -> tuple[tuple[int, int, int], int, int]:
    """Return shape, largest sample and offset of the samples of a grey or color Netpbm image."""
    header = _PNM_HEADER.match(data)
    width, height, top = (int(text) for text in header.groups()) if header else (0, 0, 0)
    if header is None or not (width and height and 0 < top < 65536):
        raise InputError(f"bad PGM/PPM header ({width} x {height}, maximum {top})")
    return (height, width, 3 if data[:2] in (b"P3", b"P6") else 1), top, header.end()


def pfm_header(data: bytes) -> tuple[tuple[int, int, int], str, int]:
    """Return shape, dtype and offset of the values of a PFM map; the sign of its scale gives the byte order."""
    header = _PFM_HEADER.match(data)
    try:
        scale = float(header[4]) if header else 0.0
    except ValueError:
        scale = 0.0
    if header is None or not (int(header[2]) and int(header[3])) or not 0 < abs(scale) < np.inf:
        raise InputError("bad PFM header")
    dtype = "<f4" if scale < 0 else ">f4"
    return (int(header[3]), int(header[2]), 3 if header[1] == b"PF" else 1), dtype, header.end()


def _decode_pnm(data: bytes) -> Image:
    """Return the image in a PGM or PPM file, plain or binary. Raise InputError if it is damaged."""
    shape, top, start = pnm_header(data)
    height, width, channels = shape
    dtype, count = np.dtype(np.uint16 if top > 255 else np.uint8), height * width * channels
    samples: NDArray[Any]
    try:
        if data[:2] in (b"P2", b"P3"):
            if len(data) > _MAX_TEXT_BYTES:
                raise InputError("too large for a plain PGM/PPM; store it as a binary one (P5, P6)")
            samples = np.array(data[start:].split(maxsplit=count)[:count]).astype(np.uint32)
        else:
            samples = np.frombuffer(data, dtype.newbyteorder(">"), count, start)
        samples = samples.reshape(shape if channels == 3 else shape[:2])
    except ValueError as error:
        raise InputError(f"truncated or damaged PGM/PPM ({error})") from None
    if samples.max() > top:
        raise InputError(f"damaged PGM/PPM (sample above the announced maximum {top})")
    return cast(Image, samples.astype(dtype))


def _check_size(height: int, width: int, bytes_a_pixel: int, stored: int) -> None:
    """Raise InputError if a file of ``stored`` bytes cannot contain the image, or decoding takes too much memory."""
    decoded = height * width * bytes_a_pixel
    if decoded > _MAX_EXPANSION * stored:
        raise InputError(f"damaged image (claims {width} x {height} pixels in {stored} bytes)")
    if decoded > _MAX_DECODED_BYTES:
        raise InputError(f"too large: {width} x {height} pixels take {decoded >> 20} MiB when decoded")


@dataclass(frozen=True)
class _TiffHeader:
    """The sample layout of a TIFF's first page."""

    size: tuple[int, int]  # height, width as stored
    samples: int  # per pixel
    bits: int  # per sample
    format: int  # of samples: 1 unsigned, 2 signed, 3 floating-point
    photometric: int
    is_separate: bool  # the channels are stored one after another
    turn: int  # key of ``_TURNS``, or 0

    @property
    def is_float(self) -> bool:
        """True if samples are floating-point."""
        return self.format == _FLOATS

    @property
    def is_image(self) -> bool:
        """True if samples are unsigned and have at most 16 bit."""
        return self.format not in (_FLOATS, _SIGNED) and self.bits <= 16

    @property
    def code(self) -> str:
        """Dtype code of samples."""
        return f"{'f' if self.is_float else 'i' if self.format == _SIGNED else 'u'}{self.bits // 8}"

    @property
    def words(self) -> str:
        """Description of the samples for messages."""
        kind = "floating point" if self.is_float else "signed integers" if self.format == _SIGNED else "integers"
        return f"{self.samples} channel{'s' * (self.samples > 1)} of {self.bits}-bit {kind}"

    @property
    def is_common(self) -> bool:
        """True if Pillow, or OpenCV for 16-bit color, decodes it correctly."""
        wide_grey = self.bits == 16 and (self.samples == 2 or self.photometric == _MIN_IS_WHITE)
        return not wide_grey and not (self.is_separate and self.samples > 1)

    def check_image(self) -> None:
        """Raise InputError if it is no 8- or 16-bit grey or color image."""
        if not self.is_image:
            raise InputError(f"{self.words}, expected an image of 8 or 16 bit")
        is_color = self.photometric > 1
        if self.samples not in ((1, 3, 4) if is_color else (1, 2)):
            raise InputError(f"{self.words}; expected one (grey) or three (RGB), with or without transparency")

    def check_numbers(self) -> None:
        """Raise InputError if it is no one-channel map."""
        if self.samples != 1 or self.bits not in ((16, 32, 64) if self.is_float else (8, 16, 32, 64)):
            raise InputError(f"{self.words}; expected a map of one channel, floating point of 16, 32 or 64 bit")


def _check_tiff(data: bytes) -> _TiffHeader:
    """Return the header of a TIFF. Raise InputError if it has several pages or is too large."""
    tags = _tiff_tags(BytesIO(data))
    with _decoding("Tiff"):
        height, width, samples = int(tags[_HEIGHT]), int(tags[_WIDTH]), int(tags.get(_SAMPLES, 1))
        bits, tile = int(tags.get(_BITS, (1,))[0]), [int(tags.get(tag, 0)) for tag in _TILES]
        turn, photometric = int(tags.get(_ORIENTATION, 1)), int(tags.get(_PHOTOMETRIC, 1))
        kind, separate = max(tags.get(_FORMAT, (1,))), int(tags.get(_PLANAR, 1)) == _SEPARATE
        kind = kind if kind in (_SIGNED, _FLOATS) else 1
    if tile[0] * tile[1] > max(4 * width * height, 1 << 22):
        raise InputError(f"damaged TIFF image (tiles of {tile[0]} x {tile[1]} pixels)")
    _check_size(height, width, samples * max(bits // 8, 1), len(data))
    if (n_pages := _n_pages(data)) > 1:
        raise InputError(f"{n_pages} pages, expected a single image; store each, or a volume as NIfTI or MetaImage")
    turn = turn if turn in _TURNS else 0
    return _TiffHeader((height, width), samples, bits, kind, photometric, separate, turn)


def _n_pages(data: bytes) -> int:
    """Return the number of pages of a TIFF, without pages of lower resolution and masks."""
    file, seen, pages = BytesIO(data), set[int](), 0
    with contextlib.suppress(InputError):  # damaged later pages do not affect the first
        tags = _tiff_tags(file)
        while True:
            pages += not int(tags.get(_SUBFILE, 0)) & _PART_OF_PAGE
            if not tags.next or tags.next in seen or len(seen) > _MAX_PAGES:
                break
            seen.add(tags.next)
            file.seek(tags.next)
            with _decoding("Tiff"):
                tags.load(file)
    return pages


def _with_tifffile(data: bytes, header: _TiffHeader) -> NDArray[Any]:
    """Return (H, W) or (H, W, 3) samples as stored, for layouts that Pillow and OpenCV do not decode."""
    import tifffile

    if header.samples > 1 and header.photometric > _RGB:
        raise InputError(f"{header.words} of photometric interpretation {header.photometric}; store it as RGB")
    logging.getLogger("tifffile").disabled = True  # its messages about damaged files are in the error
    try:
        with tifffile.TiffFile(BytesIO(data)) as file:
            pixels: NDArray[Any] = file.pages[0].asarray()
    except (ValueError, KeyError) as error:
        compressed = "imagecodecs" in str(error)
        why = "compressed, which is not read of such samples; store it uncompressed" if compressed else str(error)[:200]
        raise InputError(f"{header.words}: {why}") from None
    if header.samples > 1 and header.is_separate:
        pixels = np.moveaxis(pixels, 0, -1)
    _check_decoded(pixels, header.size, header.samples, header.bits)
    if header.samples > 1:
        pixels = pixels[..., :3] if header.samples > 2 else pixels[..., 0]
    if header.photometric == _MIN_IS_WHITE and header.is_image:
        pixels = np.iinfo(pixels.dtype).max - pixels
    return pixels


def _tiff_tags(file: IO[bytes]) -> Any:
    from PIL.TiffImagePlugin import ImageFileDirectory_v2

    with _decoding("Tiff"):
        head = file.read(16)
        if head.startswith(b"MM\0+"):
            raise InputError("a BigTIFF in big-endian order, which is not read; store it in little-endian order")
        tags: Any = ImageFileDirectory_v2(head[: 16 if 43 in head[2:4] else 8])
        file.seek(tags.next)
        tags.load(file)
        return tags


def _opened(file: IO[bytes], kind: str, verify: bool = True) -> ImageFile:
    """Return the image of a file without decoding it; ``verify`` the checksums of a PNG."""
    # Classes are called directly, since Image.open has its own limit of pixels and loads all formats.
    format: type[ImageFile] = getattr(importlib.import_module(f"PIL.{kind}ImagePlugin"), f"{kind}ImageFile")
    if verify and kind == "Png":
        format(file).verify()
        file.seek(0)
    return format(file)


def _with_opencv(data: bytes) -> NDArray[Any]:
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        pixels: NDArray[Any] | None = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    finally:
        cv2.utils.logging.setLogLevel(level)
    if pixels is None:
        raise InputError("damaged image (cannot be decoded)")
    return pixels


@contextlib.contextmanager
def _decoding(kind: str) -> Iterator[None]:
    """Turn any error of a decoder into an :class:`InputError` and drop its warnings."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except InputError:
        raise
    except Exception as error:  # decoders raise many kinds, SyntaxError and MemoryError among them
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"damaged {kind.upper()} image ({reason})") from error
