"""Pictures for people: the status of every pixel, confidence, maps in color, a legend."""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterable, Mapping
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.maps import DepthStatus, Status
from depthcli.io.formats.files import naming, read_bytes, write_bytes
from depthcli.io.formats.images import decode_bits

Palette = Mapping[int, tuple[str, tuple[int, int, int]]]
"""Bit -> (word, RGB color); 0 is a pixel without any. The first of several bits gives the color, others tint it."""

# Colors that the common kinds of color blindness tell apart (Okabe and Ito, 2008). White as a tint makes pale.
_LIGHT, _PALE, _BLACK, _WHITE = (225, 225, 225), (180, 214, 196), (0, 0, 0), (255, 255, 255)
_BLUE, _SKY, _YELLOW = (0, 114, 178), (86, 180, 233), (240, 228, 66)
_ORANGE, _VERMILION, _PURPLE, _GREEN = (230, 159, 0), (213, 94, 0), (204, 121, 167), (0, 158, 115)

NO_VALUE = _BLACK
"""RGB of a pixel without a value, in all pictures of maps, errors and statuses; no color of a map's scale."""

STATUS_PALETTE: Palette = {
    Status.MEASURED: ("measured", _LIGHT),
    Status.OCCLUDED: ("occluded", _VERMILION),
    Status.MISMATCH: ("mismatch", _BLUE),
    Status.OUT_OF_RANGE: ("out of range", _ORANGE),
    Status.NO_DATA: ("no data", NO_VALUE),
    Status.FILLED: ("filled", _WHITE),
    Status.SMOOTHED: ("smoothed", _PALE),
}
DEPTH_STATUS_PALETTE: Palette = {
    DepthStatus.KEPT: ("kept", _LIGHT),
    DepthStatus.GAP_FILLED: ("gap filled", _SKY),
    DepthStatus.CORRECTED: ("corrected", _VERMILION),
    DepthStatus.FALLBACK: ("filled from around", _YELLOW),
    DepthStatus.CARRIED: ("carried over", _PURPLE),
    DepthStatus.EMPTY: ("no value", NO_VALUE),
    DepthStatus.SMOOTHED: ("smoothed", _PALE),
    DepthStatus.SAMPLED: ("from stereo", _GREEN),
}

_SMOOTHED = int(Status.SMOOTHED)  # the same bit in both
_TINT = 0.4  # share of every further bit's color
_ROW, _SWATCH, _MARGIN = 26, 34, 8  # of the legend, pixels
_LINE = 20  # height of a line of text in pictures, pixels
_FONT = cv2.FONT_HERSHEY_SIMPLEX, 0.5  # of lines of text in pictures: capitals are 11 pixels high


def write_status(path: Path | str, status: NDArray[np.uint8], palette: Palette) -> None:
    """Write (H, W) uint8 bits as a PNG whose palette shows them in color; :func:`read_status` gives the bits back."""
    from PIL import Image

    if status.ndim != 2 or status.dtype != np.uint8:
        raise ValueError(f"expected (H, W) uint8, got {status.shape} {status.dtype}")
    picture = Image.frombytes("P", status.shape[::-1], np.ascontiguousarray(status).tobytes())
    picture.putpalette(_all_colors(tuple(palette.items())))
    _save(path, picture)


def read_status(path: Path | str) -> NDArray[np.uint8]:
    """Return the bits that :func:`write_status` wrote, (H, W) uint8."""
    data = read_bytes(path)
    with naming(path):
        return decode_bits(data)


def status_color(value: int, palette: Palette) -> tuple[int, int, int]:
    """Return the RGB color of a pixel with the bits ``value``; black where no bit is in the palette."""
    # Nearly every pixel is smoothed: that shows only without another state.
    shown = value if value == _SMOOTHED else value & ~_SMOOTHED
    colors = [np.array(color, float) for bit, (_, color) in palette.items() if shown & bit]
    if value == 0:
        colors = [np.array(palette[0][1], float)]
    mixed = colors[0] if colors else np.zeros(3)
    for color in colors[1:]:
        mixed = mixed + _TINT * (color - mixed)
    red, green, blue = np.rint(mixed).astype(int).tolist()
    return red, green, blue


@cache  # made once, not for each of many small maps
def _all_colors(entries: tuple[tuple[int, tuple[str, tuple[int, int, int]]], ...]) -> bytes:
    palette = dict(entries)
    return bytes(channel for value in range(256) for channel in status_color(value, palette))


def status_words(value: int, palette: Palette) -> str:
    """Return words for the bits ``value``, such as ``occluded, filled``."""
    words = [word for bit, (word, _) in palette.items() if (value & bit if value else bit == 0)]
    return ", ".join(words) or str(value)


def write_legend(path: Path | str, palette: Palette, values: Iterable[int] | None = None) -> None:
    """Write a picture with the meaning of each color of a status map.

    It shows the combinations of bits in ``values``; None: no bit, and each bit alone.
    """
    from PIL import Image, ImageDraw, ImageFont

    rows = sorted(set(palette if values is None else map(int, values)))
    font = ImageFont.load_default(size=14)
    words = [status_words(value, palette) for value in rows]
    width = round(max((font.getlength(text) for text in words), default=0))
    picture = Image.new("RGB", (_SWATCH + width + 3 * _MARGIN, _ROW * len(rows) + 2 * _MARGIN), _WHITE)
    draw = ImageDraw.Draw(picture)
    for number, (value, text) in enumerate(zip(rows, words, strict=True)):
        top = _MARGIN + number * _ROW
        box = (_MARGIN, top + 3, _MARGIN + _SWATCH, top + _ROW - 4)
        draw.rectangle(box, fill=status_color(value, palette), outline=_BLACK)
        draw.text((_SWATCH + 2 * _MARGIN, top + 4), text, fill=_BLACK, font=font)
    _save(path, picture)


def confidence_picture(confidence: NDArray[np.floating[Any]]) -> NDArray[np.uint8]:
    """Return (H, W) confidences as (H, W) uint8: the 1st to 99th percentile over 0 to 255; NaN is 0."""
    known = ~np.isnan(confidence)
    picture = np.zeros(confidence.shape, np.uint8)
    low, high = _range(confidence[known])
    share = (np.clip(confidence[known], low, high) - low) / (high - low) if high > low else np.ones(known.sum())
    picture[known] = np.rint(share * 255).astype(np.uint8)
    return picture


def preview(values: NDArray[np.float32], top: float) -> NDArray[np.uint8]:
    """Return an (H, W, 3) RGB picture of a map: blue = 0 to red = ``top``, black = no value."""
    known = ~np.isnan(values)
    with np.errstate(over="ignore", invalid="ignore"):
        grey = np.clip(np.rint(values * (255.0 / max(top, 1e-6))), 0, 255)
    grey = np.where(known, grey, 0).astype(np.uint8)
    picture: NDArray[Any] = cv2.cvtColor(cv2.applyColorMap(grey, cv2.COLORMAP_TURBO), cv2.COLOR_BGR2RGB)
    picture[~known] = NO_VALUE
    return picture


@cache
def map_colors() -> NDArray[np.uint8]:
    """Return (256, 3) RGB of viridis, for maps of the page and for bounds; readable without color vision."""
    grey = np.arange(256, dtype=np.uint8)[:, None]
    table: NDArray[Any] = cv2.applyColorMap(grey, cv2.COLORMAP_VIRIDIS)[:, 0, ::-1]
    return np.ascontiguousarray(table, np.uint8)


def map_picture(values: NDArray[np.floating[Any]], low: float, high: float) -> NDArray[np.uint8]:
    """Return (H, W) numbers as (H, W, 3) RGB of :func:`map_colors` over [low, high]."""
    picture = map_colors()[step_of(values, low, high, 256)]
    picture[np.isnan(values)] = NO_VALUE
    return picture


def step_of(values: NDArray[np.floating[Any]], low: float, high: float, steps: int) -> NDArray[np.intp]:
    """Return the index of numbers, NaN the lowest, among equal steps over [low, high]."""
    known = np.clip(np.nan_to_num(values.astype(np.float64), nan=low), low, max(high, low))
    index: NDArray[np.intp] = np.clip(((known - low) / max(high - low, 1e-9) * steps).astype(np.intp), 0, steps - 1)
    return index


def bound_range(bound: NDArray[np.floating[Any]]) -> tuple[float, float]:
    """Return the ends of the colors of bounds, above 0 and never the same: the 1st and the 99th percentile."""
    low, high = (float(f"{end:.2g}") for end in _range(bound[bound > 0]))
    return (low, max(high, 2 * low)) if low else (0.1, 1.0)


def bound_picture(bound: NDArray[np.floating[Any]], low: float, high: float) -> NDArray[np.uint8]:
    """Return (H, W) bounds as (H, W, 3) RGB: the logarithm over [low, high], which are above 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return map_picture(np.log(bound), math.log(low), math.log(high))


def with_bound(picture: NDArray[np.uint8], bound: NDArray[np.floating[Any]], unit: str) -> NDArray[np.uint8]:
    """Return the (H, W, 3) picture of a map, its (H, W) bounds beside it, and below these their colors in the unit."""
    (low, high), (height, width) = bound_range(bound), bound.shape
    sheet = np.full((height + 3 * _LINE, 2 * width + _MARGIN, 3), 255, np.uint8)
    sheet[:height, :width], shown = picture, sheet[:, width + _MARGIN :]
    shown[:height] = bound_picture(bound, low, high)
    shown[height + _LINE + 2 : height + 2 * _LINE - 6] = bound_picture(np.geomspace(low, high, width)[None], low, high)
    draw_text(sheet, f"bound, {unit}", (width + _MARGIN, height + _LINE // 2), _BLACK, max_width=width)
    for share in (0.0, 0.5, 1.0) if width > 5 * _LINE else (1.0,):
        number = f"{low ** (1 - share) * high**share:.2g}" + f" {unit}" * (share == 1)
        place = round(width + _MARGIN + share * (width - _text_size(number)[0])), height + 2 * _LINE + 6
        draw_text(sheet, number, place, _BLACK)
    return sheet


def preview_depth(depth: NDArray[np.float32]) -> NDArray[np.uint8]:
    """(H, W, 3) RGB picture of (H, W) depths: red = near to blue = far, even in inverse depth, black = no value."""
    with np.errstate(divide="ignore", over="ignore"):
        inverse = np.where(depth > 0, 1 / depth, np.float32(np.nan)).astype(np.float32)
    low, high = _range(inverse[~np.isnan(inverse)])
    return preview(inverse - np.float32(low), high - low)


def draw_text(
    picture: NDArray[np.uint8],
    text: str,
    place: tuple[int, int],
    ink: tuple[int, int, int],
    centered: bool = False,
    max_width: int | None = None,
) -> None:
    """Draw a line of text into an (H, W, 3) picture; characters beyond ASCII become question marks.

    ``place`` is x of its left end, or of its middle where it is ``centered``, and y of its middle line; a text of more
    than ``max_width`` pixels is cut and ends in three dots.
    """
    shown = text.encode("ascii", "replace").decode()
    while max_width is not None and len(shown) > 4 and _text_size(shown)[0] > max_width:
        shown = shown[:-4] + "..."
    width, height = _text_size(shown)
    x = place[0] - width // 2 if centered else place[0]
    cv2.putText(picture, shown, (x, place[1] + height // 2), *_FONT, ink, 1, cv2.LINE_AA)


def _text_size(text: str) -> tuple[int, int]:
    width, height = cv2.getTextSize(text, *_FONT, 1)[0]
    return width, height


def _range(values: NDArray[np.floating[Any]]) -> tuple[float, float]:
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return 0.0, 0.0
    low, high = np.percentile(finite, (1, 99))
    return float(low), float(high)


def _save(path: Path | str, picture: Any) -> None:
    file = BytesIO()
    # Runs alone make these files of few colors as small as a search for repetitions does, in a seventh of its time.
    picture.save(file, "PNG", compress_level=1, compress_type=zlib.Z_RLE)
    write_bytes(path, file.getvalue())
