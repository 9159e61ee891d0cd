"""Masks as image files: 0 is outside, the largest value of the file is inside."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.io.formats.disparity import read_plane
from depthcli.io.formats.files import shown, warn

_MIDDLEBURY = (0, 128, 255)  # unknown, visible in one view, visible in both; only the last is inside


def read_mask(path: Path | str) -> NDArray[np.bool_]:
    """Return an (H, W) mask, True above half of its largest value. It may be 0/255, 0/1, 0/128 or bool.

    Other values, as in a JPEG or a label map, cause a warning, except for Middlebury's masks.
    """
    values = read_plane(path)
    if not np.isfinite(values).all() or values.min() < 0:
        raise InputError(f"{shown(path)}: values that are negative or no numbers; expected a mask, 0 outside")
    top = values.max()
    # 128 is half of 255.
    inside: NDArray[np.bool_] = 2.0 * values > float(top) + (top > 2)
    other = (values != 0) & (values != top)
    if other.any() and not (values.dtype == np.uint8 and np.isin(values, _MIDDLEBURY).all()):
        share = 100 * np.mean(other)
        warn(f"{shown(path)}: {share:.3g} % of the pixels are neither 0 nor {top:g}; above half of that is inside")
    return inside


def read_filled_mask(path: Path | str) -> NDArray[np.bool_]:
    """Return a mask as :func:`read_mask` does. Raise InputError if no pixel is inside."""
    inside = read_mask(path)
    if not inside.any():
        raise InputError(f"{shown(path)}: no pixel is inside the mask; expected 0 outside and 255 inside")
    return inside
