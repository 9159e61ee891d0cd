"""The arrays that users have, as images, maps and masks that methods take; what cannot be one is an InputError."""

from __future__ import annotations

from os import PathLike
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from depthcli.core.errors import InputError
from depthcli.core.frames import Image, color8


def as_image(array: ArrayLike, name: str) -> Image:
    """Return an image as (H, W) grey or (H, W, 3) RGB, uint8 or uint16.

    Kernels are compiled apart for arrays that are not contiguous or cannot be written to: those are copied.

    Parameters
    ----------
    array : (H, W), (H, W, 1) or (H, W, 3) uint8, uint16, bool, or floats from 0 to 1; (H, W, 4) loses its last channel
    name : for messages
    """
    if isinstance(array, str | PathLike):
        raise InputError(f"{name}: want the image itself, not a path: read it, such as by cv2.imread(...)[..., ::-1]")
    image = np.asarray(array)
    if image.ndim == 3 and image.shape[2] in (1, 4):
        image = image[..., 0] if image.shape[2] == 1 else image[..., :3]
    if image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] != 3) or image.size == 0:
        raise InputError(f"{name}: want an image of shape (H, W) grey or (H, W, 3) RGB (got {np.shape(array)})")
    kind = image.dtype.kind
    if kind == "b":
        image = image.astype(np.uint8) * np.uint8(255)
    elif kind == "f":
        low, high = float(image.min()), float(image.max())
        if not 0 <= low <= high <= 1:  # NaN, too
            raise InputError(
                f"{name}: images of floating point hold numbers from 0 to 1 (got {low:g} to {high:g}); scale it, or "
                "convert it to uint8"
            )
        image = np.rint(image * np.float64(65535)).astype(np.uint16)
    elif image.dtype.kind != "u" or image.dtype.itemsize > 2:
        hint = "; of a list, numpy.asarray(list, numpy.uint8)" if isinstance(array, list) else ""
        raise InputError(f"{name}: want uint8, uint16, or floating point from 0 to 1 (got {image.dtype}{hint})")
    return cast(Image, np.require(image, image.dtype.newbyteorder("="), ["C", "A", "W"]))


def as_color8(array: ArrayLike, name: str) -> NDArray[np.uint8]:
    """Return an image as (H, W, 3) uint8 RGB; 16-bit images are scaled, grey ones repeated."""
    return color8(as_image(array, name))


def as_map(array: ArrayLike, name: str, shape: tuple[int, int] | None = None) -> NDArray[np.float32]:
    """Return numbers as (H, W) float32, of ``shape`` where one is given."""
    values = _numbers(array, name)
    if values.ndim != 2 or values.size == 0:
        raise InputError(f"{name}: want a map of shape (H, W) (got {values.shape})")
    if shape is not None and values.shape != shape:
        have, want = (f"{size[1]} x {size[0]}" for size in (values.shape, shape))
        raise InputError(f"{name}: {have}, but the image is {want}")
    return values


def as_depth(array: ArrayLike, name: str, scale: float, shape: tuple[int, int] | None = None) -> NDArray[np.float32]:
    """Return depths as (H, W) float32, meters, NaN = unknown; of ``shape`` where one is given.

    Parameters
    ----------
    array : (H, W) floats, meters, or integers, ``scale`` codes a meter; what is not a positive number is unknown
    """
    codes = np.asarray(array).dtype.kind in "iu"
    with np.errstate(over="ignore", invalid="ignore"):
        depth = as_map(array, name, shape)
        if codes:
            depth = (np.asarray(array) / np.float64(scale)).astype(np.float32)
    depth = np.where((depth > 0) & np.isfinite(depth), depth, np.float32(np.nan))
    if np.isnan(depth).all():
        raise InputError(f"{name}: no pixel has a depth")
    return depth


def as_volume(array: ArrayLike, name: str) -> NDArray[np.float32]:
    """Return numbers as (Z, Y, X) float32; a 2-D image has Z = 1."""
    values = _numbers(array, name)
    values = values[None] if values.ndim == 2 else values
    if values.ndim != 3 or values.size == 0:
        raise InputError(f"{name}: want a volume of shape (Z, Y, X) (got {values.shape})")
    return values


def _numbers(array: Any, name: str) -> NDArray[np.float32]:
    values = np.asarray(array)
    if values.dtype.kind not in "biuf":
        raise InputError(f"{name}: want numbers (got {values.dtype})")
    with np.errstate(over="ignore"):
        return np.require(values, np.float32, ["C", "A", "W"])
