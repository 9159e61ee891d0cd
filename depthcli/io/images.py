"""Read and write images, refusing damaged files.

OpenCV decodes many damaged files without complaint (a grey lower half, a torn row) or with lines
that only the terminal sees. Here a file either gives all of its pixels or an :class:`InputError`.
"""

from __future__ import annotations

import contextlib
import os
import re
import struct
import tempfile
import threading
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError, OutputError
from depthcli.io.atomic import write_bytes

Image = NDArray[np.uint8] | NDArray[np.uint16]

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".ppm", ".pgm", ".pnm", ".tif", ".tiff", ".bmp")
"""File name endings that scene folders are searched for, best known first."""

_PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
# Chunks that carry pixels. The others (colour profiles, text, transparency, animation) are not
# wanted and are a common cause of decoder warnings.
_PNG_NEEDED = {b"IHDR", b"PLTE", b"IDAT", b"IEND"}
_MAX_PIXELS = 1 << 29


def read_bytes(path: Path | str) -> bytes:
    """All bytes of a file; InputError where it cannot be read."""
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error


def read_image(path: Path | str) -> Image:
    """Read a PNG, JPEG, PGM, PPM, TIFF or BMP file; the kind is told by the content.

    Returns
    -------
    (H, W) grey or (H, W, 3) RGB, uint8 or uint16; transparency is dropped, palettes are resolved.

    Raises
    ------
    InputError
        Not readable, not an image, truncated or damaged, or neither 8 nor 16 bit; one line that
        names the file.
    """
    data = read_bytes(path)
    try:
        if data.startswith(_PNG_MAGIC):
            needed, grey = _check_png(data)
            pixels = _decode(needed, capture=False)
            if grey and pixels.ndim == 3:  # OpenCV turns grey with transparency into colour
                pixels = cast(Image, np.ascontiguousarray(pixels[..., 0]))
        elif data[:2] in (b"P1", b"P2", b"P3", b"P4", b"P5", b"P6"):
            return _decode_pnm(data)
        elif data.startswith(b"\xff\xd8"):
            _check_jpeg(data)
            pixels = _decode(data, capture=True)
        elif data[:4] in (b"II*\0", b"MM\0*") or data.startswith(b"BM"):
            pixels = _decode(data, capture=True)
        elif not data:
            raise InputError("the file is empty")
        else:
            raise InputError("not a PNG, JPEG, PGM, PPM, TIFF or BMP image")
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return pixels


def read_grey(path: Path | str) -> Image:
    """Read an image of codes (disparities, a mask) that may be stored with three equal channels.

    Raises
    ------
    InputError
        As :func:`read_image`, and where the channels differ.
    """
    pixels = read_image(path)
    if pixels.ndim == 3:
        first = pixels[..., 0]
        if not (np.array_equal(first, pixels[..., 1]) and np.array_equal(first, pixels[..., 2])):
            raise InputError(f"{path}: a colour image, want one channel of codes")
        return cast(Image, np.ascontiguousarray(first))
    return pixels


def write_png(path: Path | str, array: NDArray[Any]) -> None:
    """Write (H, W) grey or (H, W, 3) RGB, uint8 or uint16 (bool: 0 and 255), atomically.

    Raises
    ------
    ValueError
        Another shape or dtype.
    OutputError
        The file cannot be written.
    """
    if array.dtype == np.bool_:
        array = array.astype(np.uint8) * np.uint8(255)
    if array.dtype not in (np.uint8, np.uint16) or not (array.ndim == 2 or (array.ndim == 3 and array.shape[2] == 3)):
        raise ValueError(f"want (H, W) or (H, W, 3) uint8 or uint16, got {array.shape} {array.dtype}")
    done, code = cv2.imencode(".png", np.ascontiguousarray(array if array.ndim == 2 else array[..., ::-1]))
    if not done:
        raise OutputError(f"{path}: cannot be encoded as PNG")
    write_bytes(path, code.tobytes())


def _decode(data: bytes, capture: bool) -> Image:
    pixels: NDArray[Any] | None
    try:
        with _decoder_warnings(capture) as warnings:
            pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except (cv2.error, MemoryError) as error:
        raise InputError("damaged image (cannot be decoded)") from error
    if warnings:
        raise InputError(f"damaged image ({warnings[0]})")
    if pixels is None:
        raise InputError("damaged image (cannot be decoded)")
    if pixels.dtype not in (np.uint8, np.uint16):
        raise InputError(f"{pixels.dtype} samples, want 8 or 16 bit")
    if pixels.ndim == 3:
        if pixels.shape[2] >= 3:
            pixels = pixels[..., 2::-1]
        else:
            pixels = pixels[..., 0]
    return cast(Image, np.ascontiguousarray(pixels))


def _check_png(data: bytes) -> tuple[bytes, bool]:
    """Verify structure and checksums; the file reduced to the chunks that carry pixels, and whether it is grey."""
    out = [_PNG_MAGIC]
    at = len(_PNG_MAGIC)
    grey = False
    first = True
    while True:
        if at + 12 > len(data):
            raise InputError("truncated PNG")
        (size,) = struct.unpack_from(">I", data, at)
        kind = data[at + 4 : at + 8]
        end = at + 12 + size
        if end > len(data):
            raise InputError("truncated PNG")
        (checksum,) = struct.unpack_from(">I", data, end - 4)
        if zlib.crc32(data[at + 4 : end - 4]) != checksum:
            raise InputError(f"damaged PNG (checksum of chunk {kind.decode('latin-1')!r})")
        if first:
            if kind != b"IHDR" or size != 13:
                raise InputError("damaged PNG (no header)")
            width, height, _, color = struct.unpack_from(">IIBB", data, at + 8)
            if width * height > _MAX_PIXELS:
                raise InputError(f"PNG of {width} x {height} pixels is too large")
            grey = color in (0, 4)
            first = False
        if kind in _PNG_NEEDED:
            out.append(data[at:end])
        at = end
        if kind == b"IEND":
            break
    return b"".join(out), grey


def _check_jpeg(data: bytes) -> None:
    """Walk the JPEG markers: all segments whole, a plausible size, and an end-of-image marker."""
    at = 2
    while True:
        at = data.find(b"\xff", at)
        if at < 0 or at + 2 > len(data):
            raise InputError("truncated JPEG")
        marker = data[at + 1]
        if marker in (0x00, 0x01, 0xFF) or 0xD0 <= marker <= 0xD7:
            at += 1 if marker == 0xFF else 2
            continue
        if marker == 0xD9:
            return
        if at + 4 > len(data):
            raise InputError("truncated JPEG")
        (size,) = struct.unpack_from(">H", data, at + 2)
        if at + 2 + size > len(data):
            raise InputError("truncated JPEG")
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC) and size >= 8:
            height, width = struct.unpack_from(">HH", data, at + 5)
            # The densest JPEG code spends a quarter of a byte on 64 pixels; a header that claims
            # far more than its data can hold is damaged, and would cost gigabytes to decode.
            if width * height > 2000 * len(data):
                raise InputError(f"damaged JPEG (claims {width} x {height} pixels)")
        at += 2 + size


def _decode_pnm(data: bytes) -> Image:
    """Netpbm grey and colour images, binary (P5, P6) and plain (P2, P3)."""
    magic = data[:2]
    if magic in (b"P1", b"P4"):
        raise InputError("a bitmap (PBM), want grey or colour")
    header = re.match(rb"P\d(?:\s|#[^\n]*\n)+" + rb"(\d{1,9})(?:\s|#[^\n]*\n)+" * 2 + rb"(\d{1,9})\s", data)
    if header is None:
        raise InputError("bad PGM/PPM header")
    width, height, top = (int(text) for text in header.groups())
    if not (width and height and 0 < top < 65536) or width * height > _MAX_PIXELS:
        raise InputError(f"bad PGM/PPM header ({width} x {height}, maximum {top})")
    channels = 3 if magic in (b"P3", b"P6") else 1
    count = width * height * channels
    samples: NDArray[Any]
    if magic in (b"P2", b"P3"):
        words = data[header.end() :].split()
        if len(words) < count:
            raise InputError(f"truncated: {len(words)} samples where {count} are announced")
        try:
            samples = np.array([int(word) for word in words[:count]])
        except ValueError:
            raise InputError("damaged plain PGM/PPM (not a number)") from None
        if samples.min() < 0:
            raise InputError("damaged plain PGM/PPM (negative sample)")
    else:
        dtype = np.dtype(">u2" if top > 255 else "u1")
        missing = count * dtype.itemsize - (len(data) - header.end())
        if missing > 0:
            raise InputError(f"truncated: {missing} bytes are missing")
        samples = np.frombuffer(data, dtype, count, header.end())
    if samples.max() > top:
        raise InputError(f"damaged PGM/PPM (sample above the announced maximum {top})")
    shape = (height, width) if channels == 1 else (height, width, 3)
    return cast(Image, samples.astype(np.uint16 if top > 255 else np.uint8).reshape(shape))


_CAPTURE = threading.Lock()
# What libjpeg, libtiff and OpenCV print when they decode something broken. Other lines that pass
# by while stderr is diverted (a progress bar of another thread) are handed on untouched.
_COMPLAINT = re.compile(
    rb"\[ ?(?:WARN|ERROR|FATAL)[^\]]*\] global |> |Corrupt JPEG|Premature end of |Invalid |Inconsistent |Unsupported |"
    rb"Bogus |Unknown Adobe|Warning: unknown JFIF|Improper |Missing |TIFF"
)
_LOG_PREFIX = re.compile(r"^\[[^\]]*\] global \S+ ")  # OpenCV's time stamp and source line


@contextlib.contextmanager
def _decoder_warnings(capture: bool) -> Iterator[list[str]]:
    """Collect what C decoders write to file descriptor 2: the only sign of some damage."""
    found: list[str] = []
    if not capture:
        yield found
        return
    with _CAPTURE, contextlib.ExitStack() as stack:
        try:
            saved = os.dup(2)
        except OSError:  # stderr is closed: nothing can be seen, and nothing will be shown
            yield found
            return
        stack.callback(os.close, saved)
        sink = stack.enter_context(tempfile.TemporaryFile())
        os.dup2(sink.fileno(), 2)
        try:
            yield found
        finally:
            os.dup2(saved, 2)
            sink.seek(0)
            for line in re.findall(rb"[^\n]*\n|[^\n]+", sink.read()):
                if _COMPLAINT.match(line):
                    text = _LOG_PREFIX.sub("", line.decode("utf-8", "replace"))
                    found.append(" ".join(text.split())[:120])
                elif line.strip():
                    os.write(saved, line)
