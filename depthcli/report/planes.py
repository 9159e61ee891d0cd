"""Arrays as the page's script reads them: 16-bit codes, deflated, in base64."""

from __future__ import annotations

import base64
import math
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

Packed = dict[str, Any]

_LEVEL = 4
_TOP = 65535


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


def cuts(shape: tuple[int, ...]) -> list[tuple[str, tuple[Any, ...]]]:
    """(name, index) of the planes of an array to look at: of an image itself, of a volume the middle of every axis."""
    if len(shape) == 2:
        return [("", (...,))]
    every = (slice(None),) * len(shape)
    return [
        (f"axis {axis}, slice {n // 2} of {n}", (*every[:axis], n // 2, *every[axis + 1 :]))
        for axis, n in enumerate(shape)
    ]
