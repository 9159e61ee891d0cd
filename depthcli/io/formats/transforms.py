"""Transforms of registration programs: ITK's own formats, and the parameter files of elastix."""

from __future__ import annotations

import contextlib
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from depthcli.core.errors import InputError
from depthcli.core.volumes import Grid
from depthcli.io.formats.files import naming, open_regular, read_bytes
from depthcli.io.formats.plain_text import numbers
from depthcli.io.formats.volumes import library_errors, place, simple_itk, suffix_of

_MAX_BYTES = 1 << 30  # a text of B-spline parameters may be long
_REWRITE = "import sys, SimpleITK as s; s.WriteTransform(s.ReadTransform(sys.argv[1]), sys.argv[2])"
_MAX_SECONDS = 300  # for that; a large field of displacements takes some seconds
_INITIAL = re.compile(r'^\s*\(InitialTransformParameters?FileName\s+("[^"\n]*"|[^\s)]+)', re.MULTILINE)
_SPLINE_ORDERS = (1, 2, 3)  # those of elastix
_MAX_CHAIN = 100  # transforms of elastix that begin with one another; a registration has two or three


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
                with library_errors():
                    return sitk.CompositeTransform(_elastix_chain(path, text, ()))
        with open_regular(path) as stream:
            if os.fstat(stream.fileno()).st_size > _MAX_BYTES:
                raise InputError(f"larger than {_MAX_BYTES >> 20} MiB: no transform")
        with tempfile.TemporaryDirectory() as folder, library_errors():
            return sitk.ReadTransform(str(_rewritten(path, Path(folder))))


def _rewritten(path: Path, folder: Path) -> Path:
    """The transform as a process of its own reads and writes it: damage makes ITK and HDF5 end the one that reads."""
    target = folder / "transform.h5"
    command = [sys.executable, "-W", "ignore", "-c", _REWRITE, str(path.absolute()), str(target)]
    try:
        done = subprocess.run(command, capture_output=True, stdin=subprocess.DEVNULL, timeout=_MAX_SECONDS)
    except subprocess.TimeoutExpired:
        raise InputError(f"ITK does not read the transform within {_MAX_SECONDS} s") from None
    except (OSError, ValueError) as error:  # no process can be started; a name that no command can have
        raise InputError(f"no process can be started to read it ({error})") from None
    if done.returncode < 0:
        raise InputError("damaged: ITK crashes when it reads the transform")
    if done.returncode:
        raise InputError("not a transform that ITK can read")
    return target


def _elastix_chain(path: Path, text: str, before: tuple[Path, ...]) -> list[Any]:
    """This file's transform, then those it starts from: SimpleITK applies the last one first."""
    fields = _elastix_fields(text)
    if path.resolve() in before or len(before) > _MAX_CHAIN:
        raise InputError("its chain of initial transforms comes back to it")
    if fields.get("HowToCombineTransforms", ["Compose"])[0] != "Compose":
        raise InputError("transforms that are added, not composed, are not read")
    own = _elastix_transform(fields)
    file = _initial(path, text)
    if file is None:
        return [own]
    with naming(file):
        below = read_bytes(file, _MAX_BYTES).decode("latin-1")
    return [own, *_elastix_chain(file, below, (*before, path.resolve()))]


def _initial(path: Path, text: str) -> Path | None:
    """The file that an elastix transform starts from, beside it or where it says; None where there is none."""
    found = _INITIAL.findall(text)
    name = found[-1].strip('"') if found else ""
    if name in ("", "NoInitialTransform"):
        return None
    beside, elsewhere = path.parent / Path(name).name, Path(name)
    return elsewhere if not beside.is_file() and elsewhere.is_file() else beside


def files_read_with(path: Path) -> tuple[Path, ...]:
    """Return the files that a chain of elastix parameter files leads to, ``path`` not among them."""
    files: list[Path] = []
    with contextlib.suppress(InputError):  # reading the transform says what is wrong
        while suffix_of(path) == ".txt" and len(files) < _MAX_CHAIN:
            text = read_bytes(path, _MAX_BYTES).decode("latin-1")
            below = _initial(path, text) if "(Transform " in text else None
            if below is None or below in files:
                break
            files.append(below)
            path = below
    return tuple(files)


def _elastix_fields(text: str) -> dict[str, list[str]]:
    fields = {}
    for line in text.splitlines():
        match = re.match(r"\s*\((\w+)\s+(.*?)\)\s*(//.*)?$", line)
        if match:
            fields[match[1]] = [part.strip('"') for part in re.findall(r'"[^"]*"|\S+', match[2])] or [""]
    return fields


def _elastix_transform(fields: dict[str, list[str]]) -> Any:
    sitk = simple_itk()
    name = fields.get("Transform", [""])[0]

    def values(key: str, count: int, default: list[float] | None = None) -> list[float]:
        found: list[float] = numbers(fields.get(key, default), key, (count,)).tolist()
        return found

    if values("FixedImageDimension", 1, [3.0]) != [3.0]:
        raise InputError("not a transform of three dimensions")
    parameters = values("TransformParameters", -1)
    wanted = {"TranslationTransform": 3, "EulerTransform": 6, "AffineTransform": 12}.get(name)
    if wanted not in (None, len(parameters)):
        raise InputError(f"{name} with {len(parameters)} parameters, want {wanted}")
    if name == "TranslationTransform":
        return sitk.TranslationTransform(3, parameters)
    if name == "AffineTransform":
        return sitk.AffineTransform(parameters[:9], parameters[9:], values("CenterOfRotationPoint", 3))
    if name == "EulerTransform":
        transform = sitk.Euler3DTransform()
        transform.SetComputeZYX(fields.get("ComputeZYX", ["false"])[0] == "true")
        transform.SetCenter(values("CenterOfRotationPoint", 3))
        transform.SetParameters(parameters)
        return transform
    if name not in ("BSplineTransform", "RecursiveBSplineTransform"):
        raise InputError(f"a {name} is not read; write the field with transformix -def all")
    x, y, z = (int(n) for n in values("GridSize", 3))
    order = values("BSplineTransformSplineOrder", 1, [3.0])[0]
    if order not in _SPLINE_ORDERS:
        raise InputError(f"B-splines of order {order:.6g}, want 1, 2 or 3")
    if min(x, y, z) < 1 or len(parameters) != 3 * x * y * z:
        raise InputError(f"{len(parameters)} B-spline parameters do not fit a grid of {[x, y, z]}")
    # elastix writes the direction column by column.
    axes = np.array(values("GridDirection", 9, [1, 0, 0, 0, 1, 0, 0, 0, 1])).reshape(3, 3).T
    spacing, index = np.array(values("GridSpacing", 3)), np.array(values("GridIndex", 3, [0.0, 0.0, 0.0]))
    if min(spacing) <= 0:
        raise InputError("no usable GridSpacing")
    origin = np.array(values("GridOrigin", 3)) + axes @ (spacing * index)
    grid = Grid((x, y, z), tuple(spacing), tuple(origin), tuple(axes.ravel()))
    images = []
    for component in np.array(parameters).reshape(3, *grid.shape):
        image = sitk.GetImageFromArray(component)
        place(image, grid)
        images.append(image)
    return sitk.BSplineTransform(images, int(order))
