"""Files as they must not be: intact ones of every kind that is read, and three ways to damage them.

Everything is drawn from the generator that is given, so that a case can be repeated.
"""

import io
from functools import cache

import cv2
import numpy as np

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


def truncated(data: bytes, rng: np.random.Generator) -> bytes:
    return data[: rng.integers(len(data) + 1)]


def holed(data: bytes, rng: np.random.Generator) -> bytes:
    first, last = sorted(rng.integers(0, len(data) + 1, 2))
    return data[:first] + data[last:]


def flipped(data: bytes, rng: np.random.Generator) -> bytes:
    broken = bytearray(data)
    end = len(broken) if rng.random() < 0.5 else min(len(broken), 200)
    for _ in range(rng.integers(1, 6) if broken else 0):
        broken[rng.integers(end)] ^= 1 << rng.integers(8)
    return bytes(broken)
