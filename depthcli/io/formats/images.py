"""Read and write images, refusing damaged files.

Many decoders take damaged files without complaint (a grey lower half, a torn row). Here a file either
gives all of its pixels or an :class:`InputError`. Pillow decodes what it can hold; OpenCV decodes color of
16 bit, which Pillow cannot.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.core.frames import Image as Image
from depthcli.io.formats.files import naming, read_bytes, write_bytes
from depthcli.io.formats.headers import (
    ImageSize,
    check_png,
    check_size,
    decoding,
    holds_floats,
    image_kind,
    image_size,
    open_with_pillow,
    pnm_header,
)

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".ppm", ".pgm", ".pnm", ".tif", ".tiff", ".bmp")
"""File name endings that scene folders are searched for, best known first."""

_MAX_TEXT_BYTES = 1 << 25  # every number takes 50 bytes while it is read
_JPEG_MARKER = re.compile(rb"\xff+([^\x00\xff])")  # a coded 0xff is followed by 0, and markers by fill bytes of 0xff
_ARITHMETIC = (0xC9, 0xCA, 0xCB, 0xCD, 0xCE, 0xCF)  # markers of frames with arithmetic codes
_OTHER_BITS = bytes(range(7, 247, 5)) * 2  # put after every scan, to see whether a decoder needs more bits


def read_image(path: Path | str) -> Image:
    """Return the pixels of a PNG, JPEG, PGM, PPM, TIFF or BMP file, whose kind is found by its content.

    Returns
    -------
    (H, W) grey or (H, W, 3) RGB, uint8 or uint16; transparency is dropped, palettes are resolved.

    Raises
    ------
    InputError
        Not readable, not an image, truncated or damaged, larger than 2 GiB when decoded, or neither 8 nor 16 bit; one
        line that names the file.
    """
    data = read_bytes(path)
    with naming(path):
        return decode_image(data)


def read_grey(path: Path | str) -> Image:
    """Return an image of codes (disparities, a mask) that may be stored with three equal channels.

    Raises
    ------
    InputError
        As :func:`read_image`, and where the channels differ.
    """
    data = read_bytes(path)
    with naming(path):
        return decode_grey(data)


def decode_grey(data: bytes) -> Image:
    """Return what :func:`read_grey` does, from the bytes of a file."""
    pixels = decode_image(data)
    if pixels.ndim == 3:
        first = pixels[..., 0]
        if not (np.array_equal(first, pixels[..., 1]) and np.array_equal(first, pixels[..., 2])):
            raise InputError("a colour image, want one channel of codes")
        return cast(Image, np.ascontiguousarray(first))
    return pixels


def decode_floats(data: bytes) -> NDArray[np.float32] | None:
    """Return the (H, W) numbers of a TIFF with samples of floating point, by its bytes; None for any other file.

    Numbers of 64 bit become the nearest of 32 bit, infinite beyond their range.
    """
    if not holds_floats(data):
        return None
    size = image_size(data)
    check_size(size, len(data))
    if size.channels != 1 or size.bits not in (32, 64):
        raise InputError(f"{size.channels} x {size.bits} bit floating point, want one channel of 32 or 64")
    # Pillow knows no numbers of 64 bit, and swaps the bytes of compressed big-endian ones twice.
    pixels = _decode_with_opencv(data)
    if pixels is None or pixels.dtype.kind != "f" or pixels.shape != (size.height, size.width):
        raise InputError("damaged TIFF image (cannot be decoded)")
    with np.errstate(over="ignore"):
        return pixels.astype(np.float32)


def write_png(path: Path | str, array: NDArray[Any]) -> None:
    """Write an image as :func:`png_bytes` encodes it, atomically; OutputError where the file cannot be written."""
    write_bytes(path, png_bytes(array))


def png_bytes(array: NDArray[Any]) -> bytes:
    """Return (H, W) grey or (H, W, 3) RGB, uint8 or uint16 (bool: 0 and 255), as a PNG; ValueError for any other."""
    if array.dtype == np.bool_:
        array = array.astype(np.uint8) * np.uint8(255)
    if array.dtype not in (np.uint8, np.uint16) or not (array.ndim == 2 or (array.ndim == 3 and array.shape[2] == 3)):
        raise ValueError(f"want (H, W) or (H, W, 3) uint8 or uint16, got {array.shape} {array.dtype}")
    done, code = cv2.imencode(".png", np.ascontiguousarray(array if array.ndim == 2 else array[..., ::-1]))
    if not done:
        raise ValueError(f"{array.shape} {array.dtype} cannot be encoded as PNG")
    return code.tobytes()


def decode_image(data: bytes) -> Image:
    """Return what :func:`read_image` does, from the bytes of a file."""
    kind = image_kind(data)
    if kind in ("pfm", "npy"):
        raise InputError(f"a map of numbers ({kind}), want an image")
    size = image_size(data)
    check_size(size, len(data))
    if kind == "tiff" and (size.bits not in (8, 16) or holds_floats(data)):
        of = "floating point" if holds_floats(data) else "integers"
        raise InputError(f"samples of {size.bits} bit ({of}), want 8 or 16 bit")
    if kind == "pnm":
        return _decode_pnm(data)
    if kind == "jpeg":
        return _decode_jpeg(data)
    if kind == "png":
        data = check_png(data)
    if size.bits == 16 and (size.channels > 1 or kind == "png"):
        return _decode_16bit(data, kind, size)
    return _decode_with_pillow(data, kind)


def _decode_with_pillow(data: bytes, kind: str) -> Image:
    image = open_with_pillow(data)
    if image.mode in ("I", "F"):
        raise InputError("samples of 32 bit, or signed ones; want 8 or 16 bit")
    with decoding(kind):
        image.load()
        if image.mode in ("1", "LA", "La"):
            pixels = np.array(image.convert("L"))  # a copy: kernels are compiled apart for read-only arrays
        elif image.mode in ("L", "RGB") or image.mode.startswith("I;16"):
            pixels = np.array(image)
        else:
            pixels = np.array(image.convert("RGB"))
    return cast(Image, np.ascontiguousarray(pixels, np.uint8 if pixels.dtype == np.uint8 else np.uint16))


def _jpeg_scan_ends(data: bytes) -> list[int]:
    # Where the Huffman codes of every scan and restart interval end; none for arithmetic codes, which may end early.
    ends = []
    at, coded, restarts = 2, False, 0
    while (match := _JPEG_MARKER.search(data, at)) is not None:
        marker, at = match[1][0], match.end()
        if coded:
            ends.append(match.start())
        if marker == 0xD9:
            return ends
        if 0xD0 <= marker <= 0xD7:
            if (marker - restarts) % 8:
                raise InputError("damaged JPEG (a restart interval is missing)")
            restarts += 1
            continue
        if marker == 0x01:
            continue
        if marker in _ARITHMETIC:
            return []
        at += int.from_bytes(data[at : at + 2], "big")
        coded, restarts = marker == 0xDA, 0
    raise InputError("truncated JPEG")


def _decode_jpeg(data: bytes) -> Image:
    ends = _jpeg_scan_ends(data)
    pixels = _decode_with_pillow(data, "jpeg")
    # A scan that ends early is filled up with grey without a warning. With other bits after it, it is filled with
    # something else; bits after a complete scan are passed over.
    parts = [data[a:b] for a, b in zip([0, *ends], [*ends, len(data)], strict=True)]
    if not np.array_equal(pixels, _decode_with_pillow(_OTHER_BITS.join(parts), "jpeg")):
        raise InputError("damaged JPEG image (some of its pixels are missing)")
    return pixels


def _decode_16bit(data: bytes, kind: str, size: ImageSize) -> Image:
    pixels = _decode_with_opencv(data)
    if pixels is None or pixels.dtype != np.uint16:
        raise InputError(f"damaged {kind.upper()} image (cannot be decoded)")
    if pixels.ndim == 3:  # grey with transparency comes as color
        pixels = pixels[..., 0] if size.channels < 3 else pixels[..., 2::-1]
    return cast(Image, np.ascontiguousarray(pixels))


def _decode_with_opencv(data: bytes) -> NDArray[Any] | None:
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        with decoding(image_kind(data)):
            return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    finally:
        cv2.utils.logging.setLogLevel(level)


def _decode_pnm(data: bytes) -> Image:
    (height, width, channels, bits), top, start = pnm_header(data)
    count = height * width * channels
    samples: NDArray[Any]
    if data[:2] in (b"P2", b"P3"):
        if len(data) > _MAX_TEXT_BYTES:
            raise InputError("too large for a plain PGM/PPM; store it as a binary one (P5, P6)")
        words = data[start:].split(maxsplit=count)[:count]
        if len(words) < count:
            raise InputError(f"truncated: {len(words)} samples where {count} are announced")
        if not all(word.isdigit() and len(word) < 9 for word in words):
            raise InputError("damaged plain PGM/PPM (not a number)")
        samples = np.array(words).astype(np.uint32)
    else:
        dtype = np.dtype(f">u{bits // 8}")
        missing = count * dtype.itemsize - (len(data) - start)
        if missing > 0:
            raise InputError(f"truncated: {missing} bytes are missing")
        samples = np.frombuffer(data, dtype, count, start)
    if samples.max() > top:
        raise InputError(f"damaged PGM/PPM (sample above the announced maximum {top})")
    shape = (height, width) if channels == 1 else (height, width, channels)
    return cast(Image, samples.astype(f"u{bits // 8}").reshape(shape))
