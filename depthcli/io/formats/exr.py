"""Maps in OpenEXR files, as renderers and data sets of transparent objects store them.

Only this module imports OpenEXR, an extra (``pip install depthcli[exr]``).
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.io.formats.files import shown, silent, warn

EXR_MAGIC = b"\x76\x2f\x31\x01"

_MAX_PIXELS = 1 << 28
_MAX_EXPANSION = 4000  # pixels of a channel per stored byte; deflate expands by at most 1032
_DEPTH_NAMES = ("z", "depth", "d", "v", "disparity", "disp")  # last part of the value channel's name


def read_exr(path: Path | str) -> NDArray[Any]:
    """Return the value channel of a file, (H, W) float16, float32 or uint32, as stored.

    It is the only channel, the one called Z, depth or V (with a warning about others), or R if R, G and B are equal.
    Raise InputError if there is no such channel, the file has several or incomplete images, or OpenEXR is missing.
    """
    size, window = exr_sizes(path)
    try:
        with silent(), _module().File(os.fspath(path), separate_channels=True) as file:
            n_parts = len(file.parts)
            channels = {name: np.array(channel.pixels) for name, channel in file.channels().items()}
    except Exception as error:  # the library raises many kinds for damage
        raise InputError(f"damaged EXR file ({str(error)[:200]})") from None
    if n_parts > 1:
        raise InputError(f"an EXR file of {n_parts} parts, expected one")
    if any(values.shape != size for values in channels.values()):
        raise InputError("an EXR file whose channels have several sizes")
    if window != size:
        raise InputError(
            f"an EXR file that stores {size[1]} x {size[0]} of {window[1]} x {window[0]} pixels; store all"
        )
    name = _channel(channels)
    rest = [other for other in channels if other != name and not np.array_equal(channels[other], channels[name])]
    if rest := [other for other in rest if other.rpartition(".")[2] != "A"]:
        warn(f"{shown(path)}: its channel {name!r} is read, not {', '.join(rest)[:200]}")
    return channels[name]


def _channel(channels: dict[str, NDArray[Any]]) -> str:
    """Return the name of the value channel."""
    if len(channels) == 1:
        return next(iter(channels))
    layers: dict[str, dict[str, NDArray[Any]]] = {}
    for name, values in channels.items():
        layers.setdefault(name.rpartition(".")[0], {})[name.rpartition(".")[2]] = values
    named = [name for name in channels if name.rpartition(".")[2].lower() in _DEPTH_NAMES]
    if len(named) == 1:
        return named[0]
    if not named and len(layers) == 1:
        ((layer, parts),) = layers.items()
        if {"R", "G", "B"} <= set(parts) and all(np.array_equal(parts["R"], parts[n], equal_nan=True) for n in "GB"):
            return f"{layer}.R" if layer else "R"
    raise InputError(
        f"an EXR file of the channels {', '.join(channels)[:200]}; expected one, one called Z, or equal R, G and B"
    )


def exr_sizes(path: Path | str) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return (height, width) of the stored part and of the whole image, from the header.

    Raise InputError if the file is damaged or too large.
    """
    try:
        with silent(), _module().File(os.fspath(path), header_only=True) as file:
            windows = [file.header()[name] for name in ("dataWindow", "displayWindow")]
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"damaged EXR file ({str(error)[:200]})") from None
    stored, whole = ((int(b[1] - a[1]) + 1, int(b[0] - a[0]) + 1) for a, b in windows)
    n_pixels = stored[0] * stored[1]
    if min(stored) < 1 or n_pixels > min(_MAX_PIXELS, _MAX_EXPANSION * os.path.getsize(path)):
        raise InputError(f"damaged EXR file, or too large ({stored[1]} x {stored[0]} pixels)")
    return stored, whole


def _module() -> Any:
    try:
        import OpenEXR
    except ImportError:
        raise InputError("EXR files need OpenEXR: pip install 'depthcli[exr]'") from None
    return OpenEXR
