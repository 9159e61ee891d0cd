"""Status maps: bits as a PNG that shows them in color, and the legend of the colors."""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.io.formats.files import naming, read_bytes, write_bytes
from depthcli.io.formats.images import decode_bits
from depthcli.show.view import Palette, status_colors, status_words

_ROW, _SWATCH, _MARGIN = 26, 34, 8  # of the legend, pixels


def write_status(path: Path | str, status: NDArray[np.uint8], palette: Palette) -> None:
    """Write (H, W) uint8 bits as a PNG whose palette shows them in color; :func:`read_status` gives the bits back."""
    from PIL import Image

    if status.ndim != 2 or status.dtype != np.uint8:
        raise ValueError(f"expected (H, W) uint8, got {status.shape} {status.dtype}")
    picture = Image.frombytes("P", status.shape[::-1], np.ascontiguousarray(status).tobytes())
    picture.putpalette(status_colors(palette).tobytes())
    _save(path, picture)


def read_status(path: Path | str) -> NDArray[np.uint8]:
    """Return the bits that :func:`write_status` wrote, (H, W) uint8."""
    data = read_bytes(path)
    with naming(path):
        return decode_bits(data)


def write_legend(path: Path | str, palette: Palette, values: Iterable[int] | None = None) -> None:
    """Write a picture with the meaning of each color of a status map.

    It shows the combinations of bits in ``values``; None: no bit, and each bit alone.
    """
    from PIL import Image, ImageDraw, ImageFont

    rows = sorted(set(palette if values is None else map(int, values)))
    font = ImageFont.load_default(size=14)
    words = [status_words(value, palette) for value in rows]
    width = round(max((font.getlength(text) for text in words), default=0))
    picture = Image.new("RGB", (_SWATCH + width + 3 * _MARGIN, _ROW * len(rows) + 2 * _MARGIN), "white")
    draw = ImageDraw.Draw(picture)
    for number, (value, text) in enumerate(zip(rows, words, strict=True)):
        top = _MARGIN + number * _ROW
        box = (_MARGIN, top + 3, _MARGIN + _SWATCH, top + _ROW - 4)
        draw.rectangle(box, fill=tuple(status_colors(palette)[value].tolist()), outline="black")
        draw.text((_SWATCH + 2 * _MARGIN, top + 4), text, fill="black", font=font)
    _save(path, picture)


def _save(path: Path | str, picture: Any) -> None:
    file = BytesIO()
    # Runs alone make these files of few colors as small as a search for repetitions does, in a seventh of its time.
    picture.save(file, "PNG", compress_level=1, compress_type=zlib.Z_RLE)
    write_bytes(path, file.getvalue())
