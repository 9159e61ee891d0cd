"""Arrays as the page's script reads them: 16-bit codes, deflated, in base64; and the planes that are shown."""

from __future__ import annotations

import base64
import math
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Packed = dict[str, Any]

_DEFLATE_LEVEL = 4  # of zlib; higher ones take several times as long for a few percent
_MAX_CODE = 65535
_MAX_PIXELS = 3_000_000  # of all slices of a volume that are shown, which keeps its pictures near 10 MB per run


def pack(values: NDArray[np.floating[Any]], low: float, high: float, levels: int = _MAX_CODE) -> Packed:
    """Return numbers as 16-bit codes: ``value = origin + code * step``, and code 0 for NaN.

    Values in [low, high] span at most ``levels`` codes. Values outside go on with the same step down to code 1 and up
    to code 65535, where they are clipped. The step is a power of two, so that disparities in 256ths of a pixel, or
    depths in millimeters, come back as they are where the range allows.

    Parameters
    ----------
    values : (H, W) float, NaN = none
    low, high : smallest and largest value whose difference from its neighbors matters
    levels : number of codes between them

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


def _deflated(data: NDArray[np.uint8], shape: tuple[int, ...]) -> Packed:
    text = base64.b64encode(zlib.compress(data.tobytes(), _DEFLATE_LEVEL)).decode("ascii")
    return {"height": shape[0], "width": shape[1], "data": text}


@dataclass(frozen=True)
class Slice:
    """A plane of an array that is shown: an image itself, or a slice of a volume.

    Attributes
    ----------
    axis : the axis that it is perpendicular to, -1 for an image itself
    place, count : number of the slice along that axis, from 0, and how many there are
    index : ``array[index]`` is the plane
    """

    axis: int
    place: int
    count: int
    index: tuple[Any, ...]


def slices(shape: tuple[int, ...], max_pixels: int = _MAX_PIXELS) -> list[Slice]:
    """Return the planes that are shown: an image itself; of a volume (Z, Y, X) slices across every axis.

    The middle slices are among them.

    Parameters
    ----------
    max_pixels : of all slices together, about; where a volume has more, every second, third ... slice is taken
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
