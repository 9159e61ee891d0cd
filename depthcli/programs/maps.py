"""Images for programs, and the maps that they write, in the usual formats."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.core.errors import InputError
from depthcli.core.frames import Image
from depthcli.io.formats.disparity import read_plane
from depthcli.io.formats.files import write_bytes
from depthcli.io.formats.images import write_png
from depthcli.programs.process import ProgramError
from depthcli.programs.program import Number, Program, check_written

Format = Literal["pfm", "kitti", "npy", "tiff", "png"]

_SUFFIXES: dict[Format, str] = {"pfm": ".pfm", "kitti": ".png", "npy": ".npy", "tiff": ".tiff", "png": ".png"}


class MapProgram(Program):
    """A program that writes a map of an image's size."""

    format: Format = Field(
        "pfm",
        description="of the map: pfm, npy and tiff hold floats; png, and npy and tiff of integers, codes (see scale); "
        "kitti: png of 256 codes a unit",
    )
    scale: float | None = Field(
        None,
        gt=0,
        le=1e9,
        description="codes per unit of the map; null: floats 1, codes 256 a pixel or 1000 a meter",
    )
    invalid: tuple[Number, ...] = Field(
        (), description="values of the file that mean no value, beside inf, nan, code 0"
    )

    @property
    def suffix(self) -> str:
        return _SUFFIXES[self.format]

    def read_map(self, path: Path, shape: tuple[int, int], codes_per_unit: float) -> NDArray[np.float32]:
        """Return the map that the program wrote, as :func:`read_map`, by the format and scale of the config."""
        return read_map(path, shape, self.scale, 256.0 if self.format == "kitti" else codes_per_unit, self.invalid)


def read_map(
    path: Path, shape: tuple[int, int], scale: float | None, codes_per_unit: float, invalid: Sequence[float] = ()
) -> NDArray[np.float32]:
    """Return a map that a program wrote, (H, W) float32, NaN = no value.

    Parameters
    ----------
    shape : (H, W) that it must have
    scale : stored numbers per unit of the map; None: 1 for floats and ``codes_per_unit`` for integers
    invalid : stored numbers that stand for no value, beside infinite ones, NaN, and 0 of unsigned integers

    Raises
    ------
    ProgramError
        It is missing, empty, damaged, of another size, or has no value at all.
    """
    check_written(path)
    try:
        stored = read_plane(path)
    except InputError as error:
        raise ProgramError(f"the program's map cannot be read: {error}") from error
    if stored.shape != shape:
        (height, width), (wanted_height, wanted_width) = stored.shape, shape
        size = f"{width} x {height}, want {wanted_width} x {wanted_height}"
        raise ProgramError(f"the program's {path.name} has another size than the images: {size}")
    if scale is None:
        scale = codes_per_unit if stored.dtype.kind in "iu" else 1.0
    with np.errstate(all="ignore"):
        values = np.asarray(stored / np.float64(scale), np.float32)
        unknown = ~np.isfinite(values) | np.isin(stored, invalid)
    if stored.dtype.kind == "u":
        unknown |= stored == 0
    values[unknown] = np.nan
    if unknown.all():
        raise ProgramError(f"no pixel of the program's {path.name} has a value")
    return values


def write_input(folder: Path, name: str, image: Image, kind: str) -> Path:
    """Write an image as ``folder/name.kind``: png; pgm, of (H, W) uint8; ppm, of (H, W, 3) uint8 RGB."""
    path = folder / f"{name}.{kind}"
    if kind == "png":
        write_png(path, image)
    else:
        header = f"P{5 if image.ndim == 2 else 6}\n{image.shape[1]} {image.shape[0]}\n255\n".encode()
        write_bytes(path, header + image.tobytes())
    return path
