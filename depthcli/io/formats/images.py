"""Images as files: PNG, JPEG, Netpbm, TIFF, BMP; single ones, and the two of a pair.

OpenCV decodes color and PNG of 16 bit and TIFF of floating point, which Pillow cannot; Pillow the rest.
"""

from __future__ import annotations

import contextlib
import importlib
import re
import struct
import warnings
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.core.frames import Image as Image
from depthcli.core.frames import StereoPair, luma
from depthcli.io.formats.files import naming, open_regular, read_bytes, shown, warn, write_bytes

if TYPE_CHECKING:
    from PIL.ImageFile import ImageFile

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".ppm", ".pgm", ".pnm", ".tif", ".tiff", ".bmp")
"""File name endings that scene folders are searched for, best known first."""

NPY_MAGIC = b"\x93NUMPY"

_KINDS = {
    "Png": (b"\x89PNG\r\n\x1a\n",),
    "Jpeg": (b"\xff\xd8",),
    "Pnm": (b"P2", b"P3", b"P5", b"P6"),
    "Tiff": (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"),
    "Bmp": (b"BM",),
    "Pfm": (b"Pf", b"PF"),
    "Npy": (NPY_MAGIC,),
}
_PNM_HEADER = re.compile(rb"P\d(?:\s|#[^\n]*\n)+" + rb"(\d{1,9})(?:\s|#[^\n]*\n)+" * 2 + rb"(\d{1,9})\s")
# Comment lines, as some programs write them, may be between the numbers.
_PFM_GAP = rb"\s+(?:#[^\n]*\n\s*)*"
_PFM_HEADER = re.compile(rb"(P[fF])" + (_PFM_GAP + rb"(\d{1,9})") * 2 + _PFM_GAP + rb"([-+0-9.eE]{1,40})(?:\r\n|\s)")
_HEADER_BYTES = 1 << 14  # first part of a file, which nearly always has the size of the image
_MAX_DECODED_BYTES = 1 << 30
# Decoded bytes per stored one: 12 bits of LZW expand to up to 4 KiB; a byte of deflate for 1 KiB, of JPEG for 1.5 KiB.
_MAX_EXPANSION = 3000
_MAX_TEXT_BYTES = 1 << 25  # of a plain PGM or PPM: every number takes 50 bytes while it is read
_WIDTH, _HEIGHT, _BITS, _SAMPLES, _TILES, _FORMAT, _FLOATS = 256, 257, 258, 277, (322, 323), 339, 3  # tags of TIFF
_ORIENTATION = 274  # tag of TIFF and EXIF: how an image as stored has to be turned or mirrored to be upright
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
    """Return (H, W) grey or (H, W, 3) RGB, uint8 or uint16, of an image whose kind is found by its content.

    Transparency is dropped, palettes are resolved, EXIF orientation is applied (with a warning).
    """
    return _read(path)[0]


def _read(path: Path | str) -> tuple[Image, bytes]:
    data = read_bytes(path)
    with naming(path):
        pixels, turn = _decoded(data)
    if turn:
        warn(f"{shown(path)}: turned upright, as its EXIF orientation says ({turn})")
    return pixels, data


def read_grey(path: Path | str) -> Image:
    """Return an image of codes (disparities, a mask), which may be stored with three equal channels."""
    data = read_bytes(path)
    with naming(path):
        return decode_grey(data)


def decode_grey(data: bytes) -> Image:
    """Return what :func:`read_grey` does, from the bytes of a file."""
    pixels = decode_image(data)
    if pixels.ndim == 3 and not (pixels == pixels[..., :1]).all():
        raise InputError("a colour image, expected one channel of codes")
    return pixels if pixels.ndim == 2 else cast(Image, np.ascontiguousarray(pixels[..., 0]))


def decode_image(data: bytes) -> Image:
    """Return what :func:`read_image` does, from the bytes of a file."""
    return _decoded(data)[0]


def _decoded(data: bytes) -> tuple[Image, int]:
    # The upright image, and the EXIF orientation that it was stored in, where that is another one; else 0.
    kind, turn = image_kind(data), 0
    if kind in ("Pfm", "Npy"):
        raise InputError(f"a map of numbers ({kind.lower()}), expected an image")
    if kind == "Pnm":
        return _decode_pnm(data), turn
    if kind == "Tiff":
        bits, is_float = _check_tiff(data)
        if is_float or bits > 16:
            raise InputError(
                f"samples of {bits} bit ({'floating point' if is_float else 'integers'}), expected 8 or 16"
            )
    with _decoding(kind):
        image = _opened(data, kind)
        if (turn := _orientation(image)) and kind == "Tiff":
            # Pillow and OpenCV turn a TIFF wrongly where its sides change places: the tag becomes 1.
            order = "<" if data.startswith(b"II") else ">"
            entry, upright = (struct.pack(f"{order}HHIHH", _ORIENTATION, 3, 1, k, 0) for k in (turn, 1))
            data = data.replace(entry, upright, 1)
            image = _opened(data, kind)
        is_wide = ";16" in str(image.tile[0][3]) and (kind == "Png" or not image.mode.startswith("I;16"))
        _check_size(image.height, image.width, len(image.getbands()) * (2 if is_wide else 1), len(data))
        if is_wide:
            pixels = _with_opencv(data)
            if pixels.ndim == 3:  # grey with transparency comes as color
                pixels = pixels[..., 0] if image.mode in ("LA", "La", "I;16") else pixels[..., 2::-1]
        else:  # a copy: kernels are compiled apart for read-only arrays
            is_plain = image.mode in ("L", "RGB") or image.mode.startswith("I;16")
            plain = "L" if image.mode in ("1", "LA", "La") else "RGB"
            pixels = np.array(image if is_plain else image.convert(plain))
    if pixels.dtype.kind != "u" or pixels.dtype.itemsize > 2 or image.mode == "F":
        raise InputError("samples of 32 bit, or signed ones; expected 8 or 16 bit")
    if turn:
        pixels = _TURNS[turn](pixels)
    return cast(Image, np.ascontiguousarray(pixels, np.uint8 if pixels.dtype.itemsize == 1 else np.uint16)), turn


def _orientation(image: ImageFile) -> int:
    """Return the EXIF orientation of an image, a key of ``_TURNS``; 0 if it is upright or has none."""
    with contextlib.suppress(Exception):  # damaged EXIF data, as decoders of many kinds raise it, harm no pixel
        if "exif" in image.info or image.format == "TIFF":  # else a PNG would be decoded to look for it
            turn = int(image.getexif().get(_ORIENTATION, 1))
            return turn if turn in _TURNS else 0
    return 0


def decode_bits(data: bytes) -> NDArray[np.uint8]:
    """Return the (H, W) values of a PNG of one channel of 8 bit, which may be numbers in a palette."""
    if image_kind(data) != "Png":
        raise InputError("expected a PNG of status bits")
    with _decoding("Png"):
        image = _opened(data, "Png")
        _check_size(image.height, image.width, 1, len(data))
        if image.mode not in ("P", "L"):
            raise InputError("expected a PNG of status bits, one channel of 8 bit")
        return np.array(image, np.uint8)


def decode_floats(data: bytes) -> NDArray[np.float32] | None:
    """Return the (H, W) numbers of a TIFF with samples of floating point, by its bytes; None for any other file.

    Numbers of 64 bit become the nearest of 32 bit, infinite beyond their range.
    """
    if image_kind(data) != "Tiff" or not _check_tiff(data)[1]:
        return None
    with _decoding("Tiff"):
        pixels = _with_opencv(data)  # Pillow knows no numbers of 64 bit, and swaps some bytes twice
    if pixels.ndim != 2 or pixels.dtype not in (np.float32, np.float64):
        raise InputError(f"floating point, {pixels.shape} {pixels.dtype}: expected one channel of 32 or 64 bit")
    with np.errstate(over="ignore"):
        return pixels.astype(np.float32)


def image_size(path: Path | str) -> tuple[int, int]:
    """Return height and width of an image or map by the first bytes of its file; nothing is decoded."""
    with open_regular(path) as file, naming(path):
        data = file.read(_HEADER_BYTES)
        kind = image_kind(data)
        file.seek(0)
        if kind in ("Pnm", "Pfm"):
            return (pnm_header if kind == "Pnm" else pfm_header)(data)[0][:2]
        with _decoding(kind):
            if kind == "Npy":
                shape = np.load(path, mmap_mode="r").shape
                return int(shape[0]), int(shape[1])
            if kind == "Tiff":
                tags = _tiff_tags(file)
                size, turn = (int(tags[_HEIGHT]), int(tags[_WIDTH])), int(tags.get(_ORIENTATION, 1))
            else:
                image = _with_pillow(file, kind)
                size, turn = (image.height, image.width), _orientation(image)
            return size if turn < 5 else size[::-1]


def write_png(path: Path | str, array: NDArray[Any]) -> None:
    """Write an image as :func:`png_bytes` encodes it, atomically; OutputError where the file cannot be written."""
    write_bytes(path, png_bytes(array))


def png_bytes(array: NDArray[Any]) -> bytes:
    """Return (H, W) grey or (H, W, 3) RGB, uint8 or uint16 (bool: 0 and 255), as a PNG; ValueError for any other."""
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
    """Return a rectified pair; the range of 10- and 12-bit samples in 16-bit files is declared or found."""
    images, declared = [], []
    for path in (left, right):
        image, data = _read(path)
        images.append(image)
        with naming(path):
            declared.append(_declared_bits(data))
    bits = declared[0] if declared[0] == declared[1] else None
    return pair_of(images[0], images[1], (Path(left), Path(right)), bits)


def pair_of(left: Image, right: Image, paths: tuple[Path, Path], declared: int | None = None) -> StereoPair:
    """Return two images as a pair, both grey if one is; ``declared``: bits of the samples in the files' headers."""
    if left.shape[:2] != right.shape[:2] or left.dtype != right.dtype:
        first, second = (
            f"{image.shape[1]} x {image.shape[0]} {'grey' if image.ndim == 2 else 'colour'} {image.dtype}"
            for image in (left, right)
        )
        raise InputError(f"{shown(paths[1])}: {second}, but {shown(paths[0].name)} is {first}; the pair must agree")
    bits = sample_bits(left, right, declared=declared)
    if left.ndim != right.ndim:
        # Grey levels of one scale: luma of the color image, in as many bits as it is stored.
        left, right = luma(left), luma(right)
    return StereoPair(left, right, bits)


def sample_bits(*images: Image, declared: int | None = None) -> int:
    """Return the bits of samples of one scale: 8; or those declared, 10, 12, or 16, the first that fit the largest."""
    if images[0].dtype == np.uint8:
        return 8
    top = max(int(image.max()) for image in images)
    return next((bits for bits in (declared or 0, 10, 12) if bits <= 16 and top < 1 << bits), 16)


def _declared_bits(data: bytes) -> int | None:
    """Return the used bits of a sample by a PNG's sBIT or a PNM's maximum; or None."""
    kind = image_kind(data)
    if kind == "Png" and (at := data.find(b"sBIT", 0, max(data.find(b"IDAT"), 0))) > 0:
        return max(data[at + 4 : at + 4 + data[at - 1]], default=0) or None
    top = pnm_header(data)[1] if kind == "Pnm" else 255
    return None if top in (255, 65535) else top.bit_length()  # most programs write all ones, whatever the camera gave


def image_kind(data: bytes) -> str:
    """Return the kind of file that begins with ``data``, a key of ``_KINDS``; InputError where it is none."""
    for kind, magics in _KINDS.items():
        if data.startswith(magics):
            return kind
    if data.startswith(b"\x76\x2f\x31\x01"):
        raise InputError("an OpenEXR image, which is not read; convert it to PFM, npy or a 16-bit PNG")
    raise InputError("not a PNG, JPEG, PGM, PPM, TIFF or BMP image, nor a PFM or npy map" if data else "empty file")


def pnm_header(data: bytes) -> tuple[tuple[int, int, int], int, int]:
    """Return shape, largest sample, and where the samples begin, of a grey or color Netpbm image."""
    header = _PNM_HEADER.match(data)
    width, height, top = (int(text) for text in header.groups()) if header else (0, 0, 0)
    if header is None or not (width and height and 0 < top < 65536):
        raise InputError(f"bad PGM/PPM header ({width} x {height}, maximum {top})")
    return (height, width, 3 if data[:2] in (b"P3", b"P6") else 1), top, header.end()


def pfm_header(data: bytes) -> tuple[tuple[int, int, int], str, int]:
    """Return shape, dtype, and the start of the values, of a PFM map; the sign of its scale is the byte order."""
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
    """Refuse an image that cannot be in a file of ``stored`` bytes, or takes too much memory to decode."""
    decoded = height * width * bytes_a_pixel
    if decoded > _MAX_EXPANSION * stored:
        raise InputError(f"damaged image (claims {width} x {height} pixels in {stored} bytes)")
    if decoded > _MAX_DECODED_BYTES:
        raise InputError(f"too large: {width} x {height} pixels take {decoded >> 20} MiB when decoded")


def _check_tiff(data: bytes) -> tuple[int, bool]:
    """Return the bits of a sample of a TIFF, and whether it is of floating point; refuse one that is too large."""
    tags = _tiff_tags(BytesIO(data))
    with _decoding("Tiff"):
        height, width, samples = int(tags[_HEIGHT]), int(tags[_WIDTH]), int(tags.get(_SAMPLES, 1))
        bits, tile = int(tags.get(_BITS, (1,))[0]), [int(tags.get(tag, 0)) for tag in _TILES]
        is_float = _FLOATS in tuple(tags.get(_FORMAT, (1,)))
    if tile[0] * tile[1] > max(4 * width * height, 1 << 22):
        raise InputError(f"damaged TIFF image (tiles of {tile[0]} x {tile[1]} pixels)")
    _check_size(height, width, samples * max(bits // 8, 1), len(data))
    return bits, is_float


def _tiff_tags(file: IO[bytes]) -> Any:
    from PIL.TiffImagePlugin import ImageFileDirectory_v2

    with _decoding("Tiff"):
        head = file.read(16)
        tags: Any = ImageFileDirectory_v2(head[: 16 if 43 in head[2:4] else 8])
        file.seek(tags.next)
        tags.load(file)
        return tags


def _opened(data: bytes, kind: str) -> ImageFile:
    """Return the image of a file, of which nothing is decoded yet."""
    if kind == "Png":
        _with_pillow(BytesIO(data), kind).verify()  # the checksums of all chunks
    return _with_pillow(BytesIO(data), kind)


def _with_pillow(file: IO[bytes], kind: str) -> ImageFile:
    # Classes are called directly: Image.open has a limit of its own for the number of pixels, and loads all formats.
    module = importlib.import_module(f"PIL.{kind}ImagePlugin")
    opened: ImageFile = getattr(module, f"{kind}ImageFile")(file)
    return opened


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
