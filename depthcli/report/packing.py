"""Arrays as the page's script reads them, deflated 16-bit codes in base64; the planes that are shown; their colors."""

from __future__ import annotations

import base64
import math
import zlib
from dataclasses import dataclass
from functools import cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Packed = dict[str, Any]

NO_VALUE = (90, 90, 90)
"""RGB of a pixel of a map that has no value; no color of the map's scale."""

_DEFLATE_LEVEL = 4  # of zlib; higher ones take several times as long for a few percent
_MAX_CODE = 65535
_MAX_PIXELS = 3_000_000  # of all slices of a volume that are shown, which keeps its pictures near 10 MB per run
# By kind of pixel, from a small error to a large one. Blue and orange stay apart for every kind of color blindness,
# purple is apart from both by lightness too; the darker, the worse.
_RAMPS = (
    ("#ffffff", "#ffffff"), ("#c6dff2", "#2f7ab8"), ("#f5b13d", "#8a3000"), ("#dcdcdc", "#9b9b9b"),
    ("#dba2cf", "#5c1f57"), ("#000000", "#000000"),
)  # fmt: skip


def pack(values: NDArray[np.floating[Any]], low: float, high: float, levels: int = _MAX_CODE) -> Packed:
    """Return (H, W) numbers as 16-bit codes: ``value = origin + code * step``, and code 0 for NaN.

    Values in [low, high] span at most ``levels`` codes. Values outside go on with the same step down to code 1 and up
    to code 65535, where they are clipped. The step is a power of two, so that disparities in 256ths of a pixel, or
    depths in millimeters, come back as they are where the range allows.

    Returns
    -------
    ``height``, ``width``, ``data`` (base64 of deflated codes), ``bits`` (16), ``origin``, ``step``
    """
    step = 2.0 ** math.ceil(math.log2(max(high - low, 1e-6) / (levels - 8)))
    return _packed(values, (math.floor(low / step) - 3) * step, step)


def _packed(values: NDArray[np.floating[Any]], origin: float, step: float) -> Packed:
    known = ~np.isnan(values)
    # Codes of infinite values are clipped, those of NaN overwritten.
    with np.errstate(invalid="ignore", over="ignore"):
        scaled = np.clip(np.rint((values.astype(np.float64) - origin) / step), 1, _MAX_CODE)
    codes = np.where(known, scaled, 0).astype(np.uint16)
    # Differences have small high bytes, and alike bytes together deflate well.
    steps = np.diff(codes.ravel(), prepend=np.uint16(0))
    data = np.concatenate([(steps & 255).astype(np.uint8), (steps >> 8).astype(np.uint8)])
    return {**_deflated(data, values.shape), "bits": 16, "origin": origin, "step": step}


def pack_bytes(values: NDArray[np.uint8] | NDArray[np.bool_]) -> Packed:
    """Return an (H, W) array of small integers as it is."""
    return {**_deflated(values.astype(np.uint8).ravel(), values.shape), "bits": 8}


def _deflated(data: NDArray[np.uint8], shape: tuple[int, ...]) -> Packed:
    text = base64.b64encode(zlib.compress(data.tobytes(), _DEFLATE_LEVEL)).decode("ascii")
    return {"height": shape[0], "width": shape[1], "data": text}


def unpack(packed: Packed) -> NDArray[Any]:
    """Return the array as the page's script unpacks it: float64 with NaN, or uint8."""
    data = np.frombuffer(zlib.decompress(base64.b64decode(packed["data"])), np.uint8)
    shape = (packed["height"], packed["width"])
    if packed["bits"] == 8:
        return data.reshape(shape)
    codes = np.cumsum(data[: data.size // 2] + data[data.size // 2 :].astype(np.uint16) * 256, dtype=np.uint16)
    values = np.where(codes > 0, packed["origin"] + codes * packed["step"], np.nan)
    return values.reshape(shape)


def thinned(value: Any, factor: int) -> Any:
    """Return packed arrays, alone or in dictionaries, of every ``factor``-th pixel; anything else as it is."""
    if not isinstance(value, dict):
        return value
    if "data" not in value:
        return {name: thinned(inner, factor) for name, inner in value.items()}
    values = unpack(value)[::factor, ::factor]
    return value | (pack_bytes(values) if value["bits"] == 8 else _packed(values, value["origin"], value["step"]))


@dataclass(frozen=True)
class Slice:
    """A plane of an array that is shown, ``array[index]``: an image itself, or a slice of a volume."""

    axis: int  # that it is perpendicular to, -1 for an image itself
    place: int  # number of the slice along that axis, from 0
    n_places: int
    index: tuple[Any, ...]


def slices(shape: tuple[int, ...], max_pixels: int = _MAX_PIXELS) -> list[Slice]:
    """Return the planes that are shown: an image itself; of a volume (Z, Y, X) slices across every axis.

    The middle slices are among them. Where a volume has more than about ``max_pixels`` in all of them together, every
    second, third ... slice is taken.
    """
    if len(shape) == 2:
        return [Slice(-1, 0, 1, (...,))]
    planes = [tuple(n for other, n in enumerate(shape) if other != axis) for axis in range(3)]
    axes = [axis for axis in range(3) if min(planes[axis]) > 1] or [0]  # an image of one slice has no others
    step = max(1, math.ceil(len(axes) * math.prod(shape) / max_pixels))
    made = []
    for axis in axes:
        for place in range(shape[axis] // 2 % step, shape[axis], step):
            index = tuple(place if other == axis else slice(None) for other in range(3))
            made.append(Slice(axis, place, shape[axis], index))
    return made


@cache
def map_colors() -> NDArray[np.uint8]:
    """Return (256, 3) RGB of the map's scale: viridis, perceptually uniform, readable without color vision."""
    grey = np.arange(256, dtype=np.uint8)[:, None]
    table: NDArray[Any] = cv2.applyColorMap(grey, cv2.COLORMAP_VIRIDIS)[:, 0, ::-1]
    return np.ascontiguousarray(table, np.uint8)


@cache
def error_scales() -> NDArray[np.uint8]:
    """Return (6, 64, 3) RGB by kind of pixel and size of the error, as the page's script indexes them, too."""
    share = np.linspace(0, 1, 64)[:, None]
    ends = [[np.array([int(end[k : k + 2], 16) for k in (1, 3, 5)]) for end in ramp] for ramp in _RAMPS]
    return np.stack([np.rint(first + share * (last - first)) for first, last in ends]).astype(np.uint8)


def map_picture(values: NDArray[np.floating[Any]], low: float, high: float) -> NDArray[np.uint8]:
    """Return (H, W) numbers as (H, W, 3) RGB of the scale over [low, high]."""
    picture = map_colors()[step_of(values, low, high, 256)]
    picture[np.isnan(values)] = NO_VALUE
    return picture


def step_of(values: NDArray[np.floating[Any]], low: float, high: float, steps: int) -> NDArray[np.intp]:
    """Return the index of numbers, NaN the lowest, among equal steps over [low, high]."""
    known = np.clip(np.nan_to_num(values.astype(np.float64), nan=low), low, max(high, low))
    index: NDArray[np.intp] = np.clip(((known - low) / max(high - low, 1e-9) * steps).astype(np.intp), 0, steps - 1)
    return index
