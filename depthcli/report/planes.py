"""Arrays as the page's script reads them: 16-bit codes, deflated, in base64."""

from __future__ import annotations

import base64
import math
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Packed = dict[str, Any]

_LEVEL = 4
_TOP = 65535
_AXES = "zyx"
_MOST_PIXELS = 3_000_000  # of the slices of a volume


def pack(values: NDArray[np.floating[Any]], low: float, high: float, levels: int = _TOP) -> Packed:
    """Numbers within [low, high] as at most ``levels`` codes; 0 for none, 1 for those below, 65535 for those above.

    ``value = origin + code * step``; the step is a power of two, so that disparities in 256ths of a pixel, or depths
    in millimeters, come back as they are where the range allows.

    Parameters
    ----------
    values : (H, W) float, NaN = none
    """
    step = 2.0 ** math.ceil(math.log2(max(high - low, 1e-6) / (levels - 8)))
    return _packed(values, (math.floor(low / step) - 3) * step, step)


def _packed(values: NDArray[np.floating[Any]], origin: float, step: float) -> Packed:
    known = ~np.isnan(values)
    # Codes of infinite values are clipped, those of NaN overwritten.
    with np.errstate(invalid="ignore", over="ignore"):
        scaled = np.clip(np.rint((values.astype(np.float64) - origin) / step), 1, _TOP)
    codes = np.where(known, scaled, 0).astype(np.uint16)
    # Differences have small high bytes, and alike bytes together deflate well.
    steps = np.diff(codes.ravel(), prepend=np.uint16(0))
    data = np.concatenate([(steps & 255).astype(np.uint8), (steps >> 8).astype(np.uint8)])
    return {**_deflated(data, values.shape), "bits": 16, "origin": origin, "step": step}


def pack_bytes(values: NDArray[np.uint8] | NDArray[np.bool_]) -> Packed:
    """(H, W) small integers as they are."""
    return {**_deflated(values.astype(np.uint8).ravel(), values.shape), "bits": 8}


def unpack(packed: Packed) -> NDArray[Any]:
    """What the page's script makes of it: float64 with NaN, or uint8."""
    data = np.frombuffer(zlib.decompress(base64.b64decode(packed["data"])), np.uint8)
    shape = (packed["height"], packed["width"])
    if packed["bits"] == 8:
        return data.reshape(shape)
    codes = np.cumsum(data[: data.size // 2] + data[data.size // 2 :].astype(np.uint16) * 256, dtype=np.uint16)
    values = np.where(codes > 0, packed["origin"] + codes * packed["step"], np.nan)
    return values.reshape(shape)


def thinned(packed: Packed, factor: int) -> Packed:
    """Every ``factor``-th pixel."""
    values = unpack(packed)[::factor, ::factor]
    if packed["bits"] == 8:
        return pack_bytes(values)
    return _packed(values, packed["origin"], packed["step"])


def _deflated(data: NDArray[np.uint8], shape: tuple[int, ...]) -> Packed:
    text = base64.b64encode(zlib.compress(data.tobytes(), _LEVEL)).decode("ascii")
    return {"height": shape[0], "width": shape[1], "data": text}


@dataclass(frozen=True)
class Cut:
    """A plane of an array to look at.

    Attributes
    ----------
    axis : across which it lies, -1 for an image itself
    place, count : number of the slice along it, and how many there are
    index : of the plane in the array
    axes : names of the plane's columns and rows
    """

    axis: int
    place: int
    count: int
    index: tuple[Any, ...]
    axes: tuple[str, str]

    @property
    def name(self) -> str:
        """For people; empty for an image."""
        return "" if self.axis < 0 else f"{_AXES[self.axis]} {self.place} of {self.count}"


def cuts(shape: tuple[int, ...], most: int = _MOST_PIXELS) -> list[Cut]:
    """The planes to look at: an image itself; of a volume (Z, Y, X) slices across every axis, its middle ones included.

    Parameters
    ----------
    most : about so many pixels all slices may have; where a volume has more, every second, third ... is taken
    """
    if len(shape) == 2:
        return [Cut(-1, 0, 1, (...,), ("x", "y"))]
    planes = [tuple(n for other, n in enumerate(shape) if other != axis) for axis in range(3)]
    axes = [axis for axis in range(3) if min(planes[axis]) > 1] or [0]  # an image of one slice has no others
    step = max(1, math.ceil(len(axes) * math.prod(shape) / most))
    found = []
    for axis in axes:
        rows, columns = (name for name in _AXES if name != _AXES[axis])
        for place in range(shape[axis] // 2 % step, shape[axis], step):
            index = tuple(place if other == axis else slice(None) for other in range(3))
            found.append(Cut(axis, place, shape[axis], index, (columns, rows)))
    return found
