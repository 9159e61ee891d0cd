"""What an image file says about itself, checked before its pixels are decoded.

A few bytes can announce gigabytes, and damage can hide behind a decoder that fills in what it misses.
"""

from __future__ import annotations

import contextlib
import importlib
import re
import struct
import warnings
import zlib
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from depthcli.core.errors import InputError
from depthcli.io.formats.files import naming, open_regular, read_bytes
from depthcli.io.formats.npy import NPY_MAGIC, npy_shape

if TYPE_CHECKING:
    from PIL.ImageFile import ImageFile

ImageKind = Literal["png", "jpeg", "pnm", "tiff", "bmp", "pfm", "npy"]

PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
# Chunks that carry pixels. The others (colour profiles, text, transparency, animation) are not
# wanted and are a common cause of decoder warnings.
_PNG_NEEDED = {b"IHDR", b"PLTE", b"IDAT", b"IEND"}
_PNG_CHANNELS = {0: 1, 2: 3, 3: 3, 4: 2, 6: 4}  # by color type; of a palette those of its colors
_PNM_HEADER = re.compile(rb"P\d(?:\s|#[^\n]*\n)+" + rb"(\d{1,9})(?:\s|#[^\n]*\n)+" * 2 + rb"(\d{1,9})\s")
# Comment lines, as some programs write them, may stand between the numbers.
_PFM_GAP = rb"\s+(?:#[^\n]*\n\s*)*"
_PFM_HEADER = re.compile(rb"(P[fF])" + (_PFM_GAP + rb"(\d{1,9})") * 2 + _PFM_GAP + rb"([-+0-9.eE]{1,40})(?:\r\n|\s)")

_MAX_DECODED_BYTES = 1 << 31
_HEADER_BYTES = 1 << 14  # first part of a file, which nearly always holds the size of the image
# Decoded bytes a stored one: 12 bits of LZW stand for up to 4 KiB; a byte of deflate for 1 KiB, of JPEG for 1.5 KiB.
_MAX_EXPANSION = 3000
_SIZE_TAGS, _BITS_TAG, _SAMPLES_TAG, _TILE_TAGS = (256, 257), 258, 277, (322, 323)
_PHOTOMETRIC_TAG, _PALETTE, _FORMAT_TAG, _FLOATS = 262, 3, 339, 3

_PILLOW = {
    "png": ("PngImagePlugin", "PngImageFile"),
    "jpeg": ("JpegImagePlugin", "JpegImageFile"),
    "tiff": ("TiffImagePlugin", "TiffImageFile"),
    "bmp": ("BmpImagePlugin", "BmpImageFile"),
}


class ImageSize(NamedTuple):
    """What an image's header announces: ``bits`` of a stored sample, ``channels`` with transparency."""

    height: int
    width: int
    channels: int
    bits: int


class PnmHeader(NamedTuple):
    """Header of a Netpbm image: ``top`` is its largest sample, ``start`` where the samples begin."""

    size: ImageSize
    top: int
    start: int


class PfmHeader(NamedTuple):
    """Header of a PFM map: ``little`` endian or not, ``start`` where the values begin."""

    size: ImageSize
    little: bool
    start: int


def image_kind(data: bytes) -> ImageKind:
    """Return the kind of file that begins with ``data``; InputError where it is none that is read."""
    kinds: tuple[tuple[ImageKind, tuple[bytes, ...]], ...] = (
        ("png", (PNG_MAGIC,)),
        ("jpeg", (b"\xff\xd8",)),
        ("pnm", (b"P2", b"P3", b"P5", b"P6")),
        ("tiff", (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")),
        ("bmp", (b"BM",)),
        ("pfm", (b"Pf", b"PF")),
        ("npy", (NPY_MAGIC,)),
    )
    for kind, magics in kinds:
        if data.startswith(magics):
            return kind
    if not data:
        raise InputError("the file is empty")
    if data.startswith((b"P1", b"P4")):
        raise InputError("a bitmap (PBM), want grey or colour")
    if data.startswith(b"\x76\x2f\x31\x01"):
        raise InputError("an OpenEXR image, which is not read; convert it to PFM, npy or a 16-bit PNG")
    raise InputError("not a PNG, JPEG, PGM, PPM, TIFF or BMP image, nor a PFM or npy map")


def image_size(source: Path | str | bytes) -> ImageSize:
    """Return the size of an image or map from its header alone; nothing is decoded.

    Parameters
    ----------
    source : a file, or the bytes of one

    Raises
    ------
    InputError
        Not readable, of no kind that is read, or a header that makes no sense.
    """
    if not isinstance(source, bytes):
        data = read_bytes(source)
        with naming(source):
            return image_size(data)
    size = _SIZES[image_kind(source)](source)
    if not (size.height > 0 and size.width > 0):
        raise InputError(f"damaged image ({size.width} x {size.height} pixels)")
    return size


def peeked_size(path: Path) -> ImageSize | None:
    """Return the size of an image or map by the first bytes of its file; None where they do not hold it."""
    try:
        with open_regular(path) as file:
            return image_size(file.read(_HEADER_BYTES))
    except InputError:
        return None


def check_size(size: ImageSize, stored: int) -> None:
    """Refuse an image that cannot be in a file of ``stored`` bytes, or takes more than 2 GiB to decode.

    Raises
    ------
    InputError
        With the size, and the memory it would take.
    """
    decoded = size.height * size.width * size.channels * size.bits // 8
    announced = f"{size.width} x {size.height} pixels, {size.channels} x {size.bits} bit"
    if decoded > _MAX_EXPANSION * stored:
        raise InputError(f"damaged image (claims {announced} in {stored} bytes)")
    if 2 * decoded > _MAX_DECODED_BYTES:  # what the decoder gives, and the copy of it in our order of channels
        raise InputError(
            f"too large: {announced} take {2 * decoded / 2**20:.0f} MiB of memory to read, "
            f"{_MAX_DECODED_BYTES / 2**20:.0f} MiB may be used"
        )


def check_png(data: bytes) -> bytes:
    """Return the file with the chunks that carry pixels alone; InputError where it is truncated or damaged."""
    return PNG_MAGIC + b"".join(chunk for name, chunk in png_chunks(data) if name in _PNG_NEEDED)


def png_chunks(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Yield name and bytes (length and checksum included) of every chunk up to the end mark, verified."""
    at, name = len(PNG_MAGIC), b""
    while name != b"IEND":
        if at + 12 > len(data):
            raise InputError("truncated PNG")
        end = at + 12 + int.from_bytes(data[at : at + 4], "big")
        name = data[at + 4 : at + 8]
        if end > len(data):
            raise InputError("truncated PNG")
        if zlib.crc32(data[at + 4 : end - 4]) != int.from_bytes(data[end - 4 : end], "big"):
            raise InputError(f"damaged PNG (checksum of chunk {name.decode('latin-1')!r})")
        yield name, data[at:end]
        at = end


def pnm_header(data: bytes) -> PnmHeader:
    """Return the header of a grey or color Netpbm image; InputError where there is none."""
    header = _PNM_HEADER.match(data)
    if header is None:
        raise InputError("bad PGM/PPM header")
    width, height, top = (int(text) for text in header.groups())
    if not (width and height and 0 < top < 65536):
        raise InputError(f"bad PGM/PPM header ({width} x {height}, maximum {top})")
    size = ImageSize(height, width, 3 if data[:2] in (b"P3", b"P6") else 1, 16 if top > 255 else 8)
    return PnmHeader(size, top, header.end())


def pfm_header(data: bytes) -> PfmHeader:
    """Return the header of a PFM map, whose scale says the byte order by its sign; InputError where it is bad."""
    header = _PFM_HEADER.match(data)
    if header is None:
        raise InputError("not a PFM file (bad header)")
    width, height = int(header[2]), int(header[3])
    try:
        order = float(header[4])
    except ValueError:
        order = 0.0
    if not (width and height) or order == 0 or abs(order) == float("inf"):
        raise InputError(f"bad PFM header ({width} x {height}, scale {header[4].decode('latin-1')})")
    return PfmHeader(ImageSize(height, width, 3 if header[1] == b"PF" else 1, 32), order < 0, header.end())


def open_with_pillow(data: bytes) -> ImageFile:
    """Return a PNG, JPEG, TIFF or BMP file as Pillow opens it; its pixels are not decoded yet.

    Its classes are called directly: ``Image.open`` has a limit of its own for the number of pixels.
    """
    kind = image_kind(data)
    module, name = _PILLOW[kind]
    reader: type[ImageFile] = getattr(importlib.import_module(f"PIL.{module}"), name)  # each costs start-up time
    with decoding(kind):
        return reader(BytesIO(data))


@contextlib.contextmanager
def decoding(kind: str) -> Iterator[None]:
    """Make an :class:`InputError` of whatever a decoder raises on damaged data; its warnings are dropped."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except InputError:
        raise
    except Exception as error:  # decoders raise many kinds, SyntaxError and MemoryError among them
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"damaged {kind.upper()} image ({reason})") from error


def _png_size(data: bytes) -> ImageSize:
    name, chunk = next(png_chunks(data))
    if name != b"IHDR" or len(chunk) != 25:
        raise InputError("damaged PNG (no header)")
    width, height, bits, color = struct.unpack_from(">IIBB", chunk, 8)
    if color not in _PNG_CHANNELS or bits not in (1, 2, 4, 8, 16):
        raise InputError(f"damaged PNG (color type {color}, {bits} bit)")
    return ImageSize(height, width, _PNG_CHANNELS[color], max(bits, 8))


def _npy_size(data: bytes) -> ImageSize:
    shape, bits = npy_shape(data, len(data))
    if len(shape) not in (2, 3):
        raise InputError(f"want an (H, W) array of numbers, got shape {shape}")
    return ImageSize(shape[0], shape[1], shape[2] if len(shape) == 3 else 1, bits)


def _pillow_size(data: bytes) -> ImageSize:
    image = open_with_pillow(data)
    width, height = image.size
    return ImageSize(height, width, 3 if image.mode == "P" else len(image.getbands()), 8)


def _tiff_size(data: bytes) -> ImageSize:
    tags = _tiff_tags(data)
    with decoding("tiff"):
        width, height = (int(tags[tag]) for tag in _SIZE_TAGS)
        bits, samples = int(tags.get(_BITS_TAG, (1,))[0]), int(tags.get(_SAMPLES_TAG, 1))
        tile = [int(tags.get(tag, 0)) for tag in _TILE_TAGS]
    if tile[0] * tile[1] > max(4 * width * height, 1 << 22):
        raise InputError(f"damaged TIFF image (tiles of {tile[0]} x {tile[1]} pixels)")
    return ImageSize(height, width, 3 if tags.get(_PHOTOMETRIC_TAG) == _PALETTE else samples, max(bits, 8))


def holds_floats(data: bytes) -> bool:
    """Return whether the file is a TIFF whose samples are numbers of floating point."""
    if image_kind(data) != "tiff":
        return False
    formats = _tiff_tags(data).get(_FORMAT_TAG, (1,))
    return isinstance(formats, tuple) and _FLOATS in formats


def _tiff_tags(data: bytes) -> Any:
    from PIL.TiffImagePlugin import ImageFileDirectory_v2

    with decoding("tiff"):
        file = BytesIO(data)
        tags: Any = ImageFileDirectory_v2(data[: 16 if 43 in data[2:4] else 8])
        file.seek(tags.next)
        tags.load(file)
        return tags


_SIZES: dict[str, Callable[[bytes], ImageSize]] = {
    "png": _png_size,
    "jpeg": _pillow_size,
    "pnm": lambda data: pnm_header(data).size,
    "tiff": _tiff_size,
    "bmp": _pillow_size,
    "pfm": lambda data: pfm_header(data).size,
    "npy": _npy_size,
}
