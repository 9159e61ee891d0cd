"""Files as they must not be: intact ones of every kind that is read, and ways to damage them.

Everything is drawn from the generator that is given, so that a case can be repeated.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import socket
import struct
import zlib
from collections.abc import Callable
from functools import cache
from pathlib import Path

import cv2
import numpy as np

EXTREMES = (0, 1, 2, 255, 256, 32767, 32768, 65535, 65536, 2**31 - 1, 2**31, 2**32 - 1)
WORDS = (
    *b"0 -1 1e9 3.5 nan inf 999999999 1e305 -99999999999 300000000 -1e-320 \0 \xff\xfe '".split(b" "),
    *(b"", b"1" * 25, b"1" * 5000, b"0x" + b"f" * 5000, b"0b" + b"1" * 20_000, b"1:" * 3000 + b"1"),
)
NAMES = (
    "plain", "two words", "-o", "*", "tab\there", "line\nbreak", "\x1b[31mred", "quote'\"", "日本語", "\u202eto left",
    os.fsdecode(b"caf\xe9"), "n" * 250, ".hidden", "a;b|c&d", "%s%n", "~", "{scene}",
)  # fmt: skip


# Inputs in order, small: what is damaged later.


def encoded(suffix: str, array: np.ndarray, *options: int) -> bytes:
    return cv2.imencode(suffix, array, list(options))[1].tobytes()


@cache
def originals() -> dict[str, bytes]:
    """File name -> bytes of one intact file of every kind that is read."""
    rng = np.random.default_rng(0)
    color = cv2.GaussianBlur(rng.integers(0, 256, (40, 56, 3)).astype(np.uint8), (0, 0), 2)
    wide = color.astype(np.uint16) * 257
    values = rng.uniform(0, 60, (11, 13))
    made = {
        "grey.png": encoded(".png", color[..., 0]),
        "color.png": encoded(".png", color),
        "wide.png": encoded(".png", wide),
        "alpha.png": encoded(".png", np.dstack([wide, wide[..., 0]])),
        "codes.png": encoded(".png", (values * 256).astype(np.uint16)),
        "plain.jpg": encoded(".jpg", color),
        "progressive.jpg": encoded(".jpg", color, cv2.IMWRITE_JPEG_PROGRESSIVE, 1),
        "restart.jpg": encoded(".jpg", color, cv2.IMWRITE_JPEG_RST_INTERVAL, 2),
        "color.ppm": encoded(".ppm", color),
        "codes.pgm": encoded(".pgm", wide[..., 0]),
        "plain.pgm": b"P2 # by hand\n3 2\n4095\n0 1 2\n3 4 4095\n",
        "lzw.tiff": encoded(".tiff", color),
        "wide.tiff": encoded(".tiff", wide),
        "deflate.tiff": encoded(".tiff", color, cv2.IMWRITE_TIFF_COMPRESSION, 8),
        "stored.tiff": encoded(".tiff", color, cv2.IMWRITE_TIFF_COMPRESSION, 1),
        "color.bmp": encoded(".bmp", color),
        "map.pfm": b"Pf\n13 11\n-1\n" + values.astype("<f4").tobytes(),
    }
    half, codes, cube = values.astype(">f2"), (values * 16).astype(np.int16), rng.random((4, 5, 6))
    for name, array in {"map": values, "half": half, "codes": codes, "cube": cube}.items():
        file = io.BytesIO()
        np.save(file, array)
        made[f"{name}.npy"] = file.getvalue()
    return made


# Ways to damage bytes.


def damaged(data: bytes, rng: np.random.Generator, others: list[bytes]) -> tuple[str, bytes]:
    """Name of the damage and the damaged bytes."""
    chosen: Callable[..., bytes] = WAYS[rng.integers(len(WAYS))]
    return chosen.__name__, chosen(data, rng, others)


def truncated(data: bytes, rng: np.random.Generator, others: list[bytes]) -> bytes:
    return data[: rng.integers(len(data) + 1)]


def holed(data: bytes, rng: np.random.Generator, others: list[bytes]) -> bytes:
    first, last = sorted(rng.integers(0, len(data) + 1, 2))
    return data[:first] + data[last:]


def flipped(data: bytes, rng: np.random.Generator, others: list[bytes]) -> bytes:
    broken = bytearray(data)
    end = len(broken) if rng.random() < 0.5 else min(len(broken), 200)
    for _ in range(rng.integers(1, 6) if broken else 0):
        broken[rng.integers(end)] ^= 1 << rng.integers(8)
    return bytes(broken)


def forged(data: bytes, rng: np.random.Generator, others: list[bytes]) -> bytes:
    """Flipped bits, under checksums that are right."""
    return resealed(flipped(data, rng, others))


def lying(data: bytes, rng: np.random.Generator, others: list[bytes]) -> bytes:
    """A number of the header, in digits or in binary, says something else."""
    numbers = [found.span() for found in re.finditer(rb"-?\d+(\.\d+)?", data[:400])]
    if numbers and (data[:1] == b"P" or data[1:6] == b"NUMPY" or b"\0" not in data):
        first, last = numbers[rng.integers(len(numbers))]
        return data[:first] + WORDS[rng.integers(len(WORDS))] + data[last:]
    start = rng.integers(max(1, min(len(data), 64)))
    if data[:4] in (b"II*\0", b"MM\0*"):  # the table of a TIFF may lie at its end
        start = (int.from_bytes(data[4:8], "little") + rng.integers(200)) % max(1, len(data))
    value = EXTREMES[rng.integers(len(EXTREMES))]
    code = struct.pack(("<" if rng.random() < 0.5 else ">") + "I", value)[: rng.choice((2, 4))]
    return resealed(data[:start] + code + data[start + len(code) :])


def spliced(data: bytes, rng: np.random.Generator, others: list[bytes]) -> bytes:
    other = others[rng.integers(len(others))]
    return data[: rng.integers(len(data) + 1)] + other[rng.integers(len(other) + 1) :]


def padded(data: bytes, rng: np.random.Generator, others: list[bytes]) -> bytes:
    return data + (bytes(rng.integers(1, 4_000_000)) if rng.random() < 0.3 else rng.bytes(rng.integers(1, 300)))


def special_values(data: bytes, rng: np.random.Generator, others: list[bytes]) -> bytes:
    """Floats of the body become NaN (signalling ones too), infinite, huge, or tiny."""
    patterns = (0x7FC00000, 0x7F800001, 0x7F800000, 0xFF800000, 0x7F7FFFFF, 0x00000001, 0x80000000, 0xBF800000)
    broken = bytearray(data)
    for _ in range(20):
        at = max(0, len(broken) - 4 * int(rng.integers(1, 143)))
        broken[at : at + 4] = struct.pack("<I", patterns[rng.integers(len(patterns))])
    return bytes(broken)


def resealed(data: bytes) -> bytes:
    """Checksums of a PNG made right again, so that the damage passes them."""
    if data[1:4] != b"PNG":
        return data
    out, at = data[:8], 8
    while at + 12 <= len(data):
        end = at + 12 + int.from_bytes(data[at : at + 4], "big")
        if end > len(data):
            break
        out += data[at : end - 4] + struct.pack(">I", zlib.crc32(data[at + 4 : end - 4]))
        at = end
    return out + data[at:]


WAYS = (truncated, holed, flipped, forged, lying, lying, lying, spliced, padded, special_values)


def bomb(rng: np.random.Generator) -> tuple[str, bytes]:
    """A small file that announces, or holds, a very large image."""
    side = int(rng.choice((8_000, 20_000, 60_000, 65_500)))
    zeros = zlib.compress(bytes(side * (side + 1) if side == 8_000 else int(rng.choice((1_000, 30_000_000)))), 1)
    parts = [struct.pack(">IIBBBBB", side, side, rng.choice((8, 16)), rng.choice((0, 2, 4, 6)), 0, 0, 0), zeros, b""]
    chunks = [
        struct.pack(">I", len(p)) + n + p + bytes(4) for n, p in zip((b"IHDR", b"IDAT", b"IEND"), parts, strict=True)
    ]
    jpeg = bytearray(encoded(".jpg", np.zeros((8, 8, 3), np.uint8)) + bytes(int(rng.choice((0, 5_000_000)))))
    at = jpeg.index(b"\xff\xc0")
    jpeg[at + 5 : at + 9] = struct.pack(">HH", side, side)
    size = str(side).encode()
    tags = {256: side, 257: side, 258: 8, 259: 8, 262: 1, 273: 8, 277: 1, 278: rng.choice((1, side)), 279: len(zeros)}
    entries = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in tags.items())
    directory = struct.pack("<H", len(tags)) + entries + bytes(4)
    descr = f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({side}, {side}), }}".ljust(117).encode()
    bombs = {
        "bomb.png": resealed(b"\x89PNG\r\n\x1a\n" + b"".join(chunks)),
        "bomb.jpg": bytes(jpeg),
        "bomb.tiff": b"II*\0%b" % struct.pack("<I", 8 + len(zeros)) + zeros + directory,
        "bomb.pgm": b"P5 " + size + b" " + size + b" 65535\n" + zeros,
        "bomb.pfm": b"Pf\n" + size + b" " + size + b"\n-1\n" + zeros,
        "bomb.bmp": b"BM" + struct.pack("<IIIIiiHHIIIIII", 0, 0, 54, 40, side, side, 1, 24, 0, 0, 0, 0, 0, 0),
        "bomb.npy": b"\x93NUMPY\1\0\x76\0" + descr + b"\n",
    }
    name = list(bombs)[rng.integers(len(bombs))]
    return name, bombs[name]


def put_special(path: Path, rng: np.random.Generator) -> str:
    """Something at ``path`` that is no regular file, or no readable one."""
    targets = {"zero": "/dev/zero", "full": "/dev/full", "dangling": "/absent/x", "proc": "/proc/self/pagemap"}
    targets["loop"] = path.name
    kind = str(rng.choice(["pipe", "socket", "folder", "nothing", "empty", "huge", "closed", *targets]))
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "socket":
        with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX) as server:  # the path may be too long for one
            server.bind(str(path))
    elif kind == "folder":
        path.mkdir()
    elif kind == "huge":
        with path.open("wb") as file:
            file.truncate(1 << 41)
    elif kind in ("empty", "closed"):
        path.write_bytes(b"")
        path.chmod(0o000 if kind == "closed" else 0o644)
    elif kind != "nothing":
        path.symlink_to(targets[kind])
    return kind
