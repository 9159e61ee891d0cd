"""Convert user input: presets and overrides to configs; arrays to images, maps and volumes."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BaseModel

from depthcli.core import config_file
from depthcli.core.errors import InputError
from depthcli.core.frames import Image, StereoPair, color8
from depthcli.core.method import RootConfig
from depthcli.core.yaml_source import ConfigData
from depthcli.io.formats.depth import meters
from depthcli.io.formats.images import bits_said, pair_of, squeezed

ModelT = TypeVar("ModelT", bound=RootConfig)

Overrides = Mapping[str, object]
"""Config key, ``a.b`` or a plain name -> value."""


def load_config(
    model: type[ModelT], preset: str | Path | ModelT, overrides: Overrides | None = None, **fields: object
) -> ModelT:
    """Return a checked config. Raise ConfigError with one line for each problem of preset, keys and values.

    Parameters
    ----------
    model : class of the config: ``StereoConfig``, ``FuseConfig``, ``RefineKinectConfig``, ``TransparentConfig`` or
        ``RegisterConfidenceConfig``
    preset : name of a preset (``depthcli presets`` lists them), path of a YAML file, or a config
    overrides : key -> value, as in ``--set``: ``{"cost.window": 9}``. A mapping as a value changes only its own keys,
        unless it names a method
    **fields : overrides for keys that are Python names

    Examples
    --------
    >>> import depthcli
    >>> config = depthcli.load_config(depthcli.StereoConfig, "accurate", {"optimization.p2": 6}, max_disparity=64)
    >>> config.max_disparity
    64
    """
    values = {key: _plain(value) for key, value in {**(overrides or {}), **fields}.items()}
    if isinstance(preset, model):
        if not values:
            return preset
        data = ConfigData("config", preset.model_dump(mode="json", by_alias=True))
        return config_file.load_config(model, data, values=values)
    return config_file.load_config(model, config_file.find_config(model.command, str(preset)), values=values)


def _plain(value: Any) -> Any:
    """Return a value as it would come from a YAML file."""
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json", by_alias=True)
    if isinstance(value, Mapping):
        return {str(key): _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    if isinstance(value, Path):
        return str(value)
    return value.tolist() if hasattr(value, "tolist") else value  # numpy scalars and arrays


def as_image(array: ArrayLike, name: str) -> Image:
    """Return an image as (H, W) grey or (H, W, 3) RGB, uint8 or uint16. Raise InputError for other arrays.

    The array has uint8, uint16, bool, or floats from 0 to 1, and 1, 3 or 4 channels; the fourth is dropped. Arrays that
    are not contiguous or not writable are copied, since kernels would be compiled again for them.
    """
    if isinstance(array, str | PathLike):
        raise InputError(f"{name}: expected an image, got a path: read it, such as by cv2.imread(...)[..., ::-1]")
    if np.ma.is_masked(array):
        raise InputError(f"{name}: a masked array; an image has a value at every pixel: give array.filled(...)")
    image = np.asarray(array)
    if image.ndim == 3 and image.shape[2] in (1, 4):
        image = image[..., 0] if image.shape[2] == 1 else image[..., :3]
    if image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] != 3) or image.size == 0:
        raise InputError(f"{name}: expected an image of shape (H, W) or (H, W, 3), got {np.shape(array)}")
    if image.dtype.kind == "b":
        image = image.astype(np.uint8) * np.uint8(255)
    elif image.dtype.kind == "f":
        low, high = float(image.min()), float(image.max())
        if not 0 <= low <= high <= 1:  # NaN, too
            raise InputError(f"{name}: floats must be from 0 to 1, got {low:g} to {high:g}; scale them, or give uint8")
        image = np.rint(image * np.float64(65535)).astype(np.uint16)
    elif image.dtype.kind != "u" or image.dtype.itemsize > 2:
        raise InputError(f"{name}: expected uint8, uint16, or floats from 0 to 1, got {image.dtype}")
    return cast(Image, np.require(image, image.dtype.newbyteorder("="), ["C", "A", "W"]))


def as_color8(array: ArrayLike, name: str) -> NDArray[np.uint8]:
    """Return an array for :func:`as_image` as (H, W, 3) uint8 RGB; uint16 is scaled by the number of bits in use."""
    image = as_image(array, name)
    return color8(image, bits_said((image,), name, 16 if np.asarray(array).dtype.kind in "bf" else None))


def as_pair(left: ArrayLike, right: ArrayLike) -> StereoPair:
    """Return two arrays for :func:`as_image` as a rectified pair. Raise InputError if sizes or dtypes differ."""
    return paired(as_image(left, "left"), as_image(right, "right"), left)


def paired(left: Image, right: Image, given: ArrayLike) -> StereoPair:
    """Return a pair of images. If ``given``, the user's array, has floats, even dark images use all 16 bits."""
    return pair_of(left, right, (Path("left"), Path("right")), 16 if np.asarray(given).dtype.kind == "f" else None)


def as_map(array: ArrayLike, name: str, shape: tuple[int, int] | None = None) -> NDArray[np.float32]:
    """Return numbers as (H, W) float32, with ``shape`` if given. Raise InputError for other arrays."""
    values = squeezed(_numbers(array, name), 2)
    if values.ndim != 2 or values.size == 0:
        raise InputError(f"{name}: expected a map of shape (H, W), got {values.shape}")
    if shape is not None and values.shape != shape:
        got, expected = (f"{size[1]} x {size[0]}" for size in (values.shape, shape))
        raise InputError(f"{name}: {got}, but the image is {expected}")
    return values


def as_depth(
    array: ArrayLike,
    name: str,
    scale: float | None,
    shape: tuple[int, int] | None = None,
    scale_floats: bool = True,
) -> NDArray[np.float32]:
    """Return depths as (H, W) float32, meters, NaN = unknown.

    ``scale`` is in codes per meter; by default, integers are millimeters and floats meters. Without ``scale_floats``,
    floats are always meters. :func:`depthcli.io.formats.depth.meters` defines unknown values. Raise InputError as
    :func:`as_map`, or if all depths are unknown.
    """
    as_map(array, name, shape)
    numbers = squeezed(np.ma.filled(array, 0) if isinstance(array, np.ma.MaskedArray) else np.asarray(array), 2)
    depth = meters(numbers, scale, name, scale_floats=scale_floats)
    if np.isnan(depth).all():
        raise InputError(f"{name}: no pixel has a depth")
    return depth


def as_volume(array: ArrayLike, name: str) -> NDArray[np.float32]:
    """Return numbers as (Z, Y, X) float32; a 2-D image gets Z = 1. Raise InputError for other arrays."""
    values = _numbers(array, name)
    values = values[None] if values.ndim == 2 else values
    if values.ndim != 3 or values.size == 0:
        raise InputError(f"{name}: expected a volume of shape (Z, Y, X), got {values.shape}")
    return values


def _numbers(array: ArrayLike, name: str) -> NDArray[np.float32]:
    values = np.asarray(array)
    if values.dtype.kind not in "biuf":
        raise InputError(f"{name}: expected numbers, got {values.dtype}")
    with np.errstate(over="ignore"):
        numbers = np.require(values, np.float32, ["C", "A", "W"])
    if isinstance(array, np.ma.MaskedArray):
        numbers = np.where(np.ma.getmaskarray(array), np.float32(np.nan), numbers)
    return numbers
