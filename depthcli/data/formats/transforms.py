"""Transforms of registration programs: ITK's own formats, and the parameter files of elastix."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from depthcli.core.errors import InputError
from depthcli.core.volumes import Grid
from depthcli.data.formats.files import naming, open_regular, read_bytes
from depthcli.data.formats.volumes import place, quiet, simple_itk, suffix_of

TRANSFORM_SUFFIXES = (".tfm", ".txt", ".h5", ".hdf5", ".mat", ".xfm")
_MAX_BYTES = 1 << 30  # a text of B-spline parameters may be long


def read_transform(path: Path) -> Any:
    """Return the SimpleITK transform of a file of ITK, or of a chain of elastix parameter files.

    Raises
    ------
    InputError
        Not readable, or a kind of transform that is not read.
    """
    sitk = simple_itk()
    with naming(path):
        if suffix_of(path) == ".txt":
            text = read_bytes(path, _MAX_BYTES).decode("latin-1")
            if "(Transform " in text:
                return sitk.CompositeTransform(_elastix_chain(path, text, ()))
        with open_regular(path):
            pass
        try:
            with quiet():
                return sitk.ReadTransform(str(path))
        except RuntimeError:
            raise InputError("not a transform that ITK can read") from None


def _elastix_chain(path: Path, text: str, before: tuple[Path, ...]) -> list[Any]:
    """This file's transform, then those it starts from: SimpleITK applies the last one first."""
    fields = _elastix_fields(text)
    if path.resolve() in before:
        raise InputError("its chain of initial transforms comes back to it")
    if fields.get("HowToCombineTransforms", ["Compose"])[0] != "Compose":
        raise InputError("transforms that are added, not composed, are not read")
    own = _elastix_transform(fields)
    initial = (
        fields.get("InitialTransformParameterFileName") or fields.get("InitialTransformParametersFileName") or [""]
    )[0]
    if initial in ("", "NoInitialTransform"):
        return [own]
    file = path.parent / Path(initial).name
    if not file.is_file() and Path(initial).is_file():
        file = Path(initial)
    with naming(file):
        below = read_bytes(file, _MAX_BYTES).decode("latin-1")
    return [own, *_elastix_chain(file, below, (*before, path.resolve()))]


def _elastix_fields(text: str) -> dict[str, list[str]]:
    fields = {}
    for line in text.splitlines():
        match = re.match(r"\s*\((\w+)\s+(.*?)\)\s*(//.*)?$", line)
        if match:
            fields[match[1]] = [part.strip('"') for part in re.findall(r'"[^"]*"|\S+', match[2])]
    return fields


def _elastix_transform(fields: dict[str, list[str]]) -> Any:
    sitk = simple_itk()
    name = fields["Transform"][0]

    def numbers(key: str, default: list[float] | None = None) -> list[float]:
        if key not in fields and default is not None:
            return default
        try:
            return [float(value) for value in fields[key]]
        except (KeyError, ValueError):
            raise InputError(f"no usable {key}") from None

    if numbers("FixedImageDimension", [3.0]) != [3.0]:
        raise InputError("not a transform of three dimensions")
    parameters = numbers("TransformParameters")
    makers: dict[str, tuple[int, Callable[[], Any]]] = {
        "TranslationTransform": (3, lambda: sitk.TranslationTransform(3, parameters)),
        "EulerTransform": (6, lambda: _euler(parameters, numbers("CenterOfRotationPoint"), fields)),
        "AffineTransform": (
            12,
            lambda: sitk.AffineTransform(parameters[:9], parameters[9:], numbers("CenterOfRotationPoint")),
        ),
    }
    if name in makers:
        wanted, make = makers[name]
        if len(parameters) != wanted:
            raise InputError(f"{name} with {len(parameters)} parameters, want {wanted}")
        return make()
    if name not in ("BSplineTransform", "RecursiveBSplineTransform"):
        raise InputError(f"a {name} is not read; write the field with transformix -def all")
    size = [int(n) for n in numbers("GridSize")]
    order = int(numbers("BSplineTransformSplineOrder", [3.0])[0])
    if len(size) != 3 or min(size) < 1 or len(parameters) != 3 * size[0] * size[1] * size[2]:
        raise InputError(f"{len(parameters)} B-spline parameters do not fit a grid of {size}")
    # elastix writes the direction column by column.
    axes = np.array(numbers("GridDirection", [1, 0, 0, 0, 1, 0, 0, 0, 1])).reshape(3, 3).T
    spacing, index = np.array(numbers("GridSpacing")), np.array(numbers("GridIndex", [0, 0, 0]))
    origin = np.array(numbers("GridOrigin")) + axes @ (spacing * index)
    grid = Grid((size[0], size[1], size[2]), tuple(spacing), tuple(origin), tuple(axes.ravel()))
    images = []
    for component in np.array(parameters).reshape(3, *grid.shape):
        image = sitk.GetImageFromArray(component)
        place(image, grid)
        images.append(image)
    return sitk.BSplineTransform(images, order)


def _euler(parameters: list[float], center: list[float], fields: dict[str, list[str]]) -> Any:
    sitk = simple_itk()
    transform = sitk.Euler3DTransform()
    transform.SetComputeZYX(fields.get("ComputeZYX", ["false"])[0] == "true")
    transform.SetCenter(center)
    transform.SetParameters(parameters)
    return transform
