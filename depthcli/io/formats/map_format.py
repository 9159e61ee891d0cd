"""Map formats of plug-ins, recognized by the endings of files."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import DepthcliError, InputError
from depthcli.core.plugins import Plugin, Registry, plugins_of, registered_name
from depthcli.io.formats.files import open_regular, shown
from depthcli.io.formats.images import IMAGE_SUFFIXES

MAP_SUFFIXES = (".pfm", ".npy", ".npz", ".exr", *IMAGE_SUFFIXES)
"""Endings of the maps that this package reads itself, most exact first."""


class MapFormat(ABC):
    """A format of one-channel maps, for endings that this package does not read itself."""

    suffixes: ClassVar[tuple[str, ...]]
    """Endings of file names, in lower case, with the dot."""

    def __init_subclass__(cls) -> None:
        """Raise TypeError if the endings are not lower-case endings in a tuple, or the package reads them itself."""
        suffixes = getattr(cls, "suffixes", ())
        if not isinstance(suffixes, tuple) or not all(str(suffix).startswith(".") for suffix in suffixes):
            raise TypeError(f"suffixes: expected a tuple of endings such as ('.flo5',), got {suffixes!r}")
        if taken := [suffix for suffix in suffixes if suffix in MAP_SUFFIXES or suffix != suffix.lower()]:
            raise TypeError(f"suffixes: {taken[0]} is read by depthcli itself, or not in lower case")

    @property
    def name(self) -> str:
        """Name of the plug-in."""
        return registered_name(type(self))

    @abstractmethod
    def read(self, path: Path) -> NDArray[Any]:
        """Return the map as stored. Raise InputError, ValueError or OSError if the file is damaged.

        Returns
        -------
        (H, W) floats: disparities in pixels or depths in meters, NaN or infinite = unknown; or (H, W) integers: codes,
        which are divided by the scale that the user or the scene gives, 0 = unknown
        """


_REGISTRY = Registry[MapFormat](__name__)


def map_formats() -> dict[str, MapFormat]:
    """Return ending -> plug-in's format; if several have the same ending, the first in order of names is used."""
    formats = [kind() for _, kind in sorted(_REGISTRY.added.items())]
    return {suffix: each for each in reversed(formats) for suffix in each.suffixes}


def map_suffixes() -> tuple[str, ...]:
    """Return the endings of all map files, the package's own first."""
    return (*MAP_SUFFIXES, *sorted(map_formats()))


def format_plugins(files: Iterable[Path]) -> set[Plugin]:
    """Return the plug-ins that read any of these files."""
    formats = map_formats()
    return plugins_of(type(formats[path.suffix.lower()]) for path in files if path.suffix.lower() in formats)


def read_by_plugin(path: Path | str) -> NDArray[Any] | None:
    """Return the map that a plug-in reads from a file, or None if no plug-in reads its ending."""
    if (reader := map_formats().get(Path(path).suffix.lower())) is None:
        return None
    with open_regular(path):  # raises if the file is not regular or cannot be opened
        pass
    try:
        values = np.asarray(reader.read(Path(path)))
        if values.ndim != 2 or values.dtype.kind not in "iuf" or not values.size:
            raise InputError(f"format {reader.name}: expected (H, W) numbers, got {values.shape} {values.dtype}")
        return values
    except Exception as error:  # a plug-in may raise anything
        why = (str(error).splitlines() or [type(error).__name__])[0]
        text = why if isinstance(error, DepthcliError) else f"cannot be read as {reader.name}: {why}"
        raise InputError(text if str(path) in text else f"{shown(path)}: {text}") from error
