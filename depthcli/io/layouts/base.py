"""A folder as a layout sees it, the class of layouts, and the layouts of one kind of scene."""

from __future__ import annotations

import contextlib
import os
from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, Generic, TypeVar

from depthcli.core.errors import InputError
from depthcli.core.plugins import Plugin, plugins_of
from depthcli.core.registry import Registry, registered_name
from depthcli.core.text import short
from depthcli.io.formats.files import naming, read_bytes
from depthcli.io.formats.plain_text import json_object, numbers
from depthcli.io.formats.poses import Pose, pose_of
from depthcli.io.scenes import Scene

SceneT = TypeVar("SceneT", bound=Scene)

_MAX_POSITIVE, _MAX_WHOLE = 1e6, 1 << 20  # numbers of meta.json; no image is as wide


def _is_folder(entry: os.DirEntry[str]) -> bool:
    with contextlib.suppress(OSError):  # a link to itself
        return entry.is_dir()
    return False


class Folder:
    """One folder as a layout sees it, names only: nothing in it is opened.

    ``name`` is that of a scene that is the folder itself, ``prefix`` what the names of scenes inside begin with,
    ``requested`` the layout that the user named, or empty.
    """

    def __init__(self, path: Path, name: str, prefix: str, requested: str = "") -> None:
        self.path, self.name, self.prefix, self.requested = path, name, prefix, requested
        try:
            with naming(path), os.scandir(path) as entries:
                shown = [entry for entry in entries if entry.name[0] != "."]
                self.names = frozenset([entry.name for entry in shown])
                self._folders = frozenset([entry.name for entry in shown if _is_folder(entry)])
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error

    def has(self, *names: str) -> bool:
        """Return whether all of the names are there."""
        return set(names) <= self.names

    def endings(self, stem: str) -> list[str]:
        """Return the endings of the files of that stem, in lower case."""
        return [suffix for suffix, _ in self._by_stem.get(stem, ())]

    def one(self, stem: str, suffixes: Iterable[str]) -> Path | None:
        """Return the file of that stem; InputError where several endings compete."""
        named = self._by_stem.get(stem)
        if named is None:  # nearly always: all layouts ask for their own names
            return None
        fitting = [name for suffix, name in named if suffix in suffixes]
        if len(fitting) > 1:
            raise InputError(f"{self.path}: both {fitting[0]} and {fitting[1]}; keep one")
        return self.path / fitting[0] if fitting else None

    def below(self, place: str) -> Folder | None:
        """Return the folder at a path in this one, or None."""
        if place not in self._below:
            path = Path(os.path.normpath(self.path / place))
            self._below[place] = Folder(path, self.name, self.prefix) if os.path.isdir(path) else None
        return self._below[place]

    @cached_property
    def _below(self) -> dict[str, Folder | None]:
        return {"": self}

    @cached_property
    def _by_stem(self) -> dict[str, list[tuple[str, str]]]:
        return _by_stem(self.names - self._folders)

    @cached_property
    def meta(self) -> Meta:
        """The fields of ``meta.json`` that have a value; none without such a file."""
        path = self.path / "meta.json"
        if path.name not in self.names:
            return Meta(path, {})
        data = read_bytes(path)
        with naming(path):
            fields = json_object(data)
        return Meta(path, {key: value for key, value in fields.items() if value is not None})


@lru_cache(maxsize=8)  # folders of thousands of scenes have the same names in them
def _by_stem(names: frozenset[str]) -> dict[str, list[tuple[str, str]]]:
    """Return stem -> (ending in lower case, name), sorted; names end as for pathlib, ``.nii.gz`` with both parts."""
    by_stem: dict[str, list[tuple[str, str]]] = {}
    for name in sorted(names):
        dot = name.rfind(".")
        dot = dot if 0 < dot < len(name) - 1 else len(name)
        if name.lower().endswith(".nii.gz") and dot > 4:
            dot -= 4
        by_stem.setdefault(name[:dot], []).append((name[dot:].lower(), name))
    return by_stem


class Meta:
    """Fields of a ``meta.json``, checked; a method returns None, or its default, where the file lacks the field."""

    def __init__(self, path: Path, fields: dict[str, Any]) -> None:
        self.path, self.fields = path, fields

    def positive(self, key: str) -> float | None:
        """Return a positive number below a million."""
        value = self.fields.get(key)
        if value is not None and (type(value) not in (int, float) or not 0 < value < _MAX_POSITIVE):
            raise self.error(key, "a positive number")
        return None if value is None else float(value)

    def whole(self, key: str, low: int = -_MAX_WHOLE) -> int | None:
        """Return a whole number, not below ``low``."""
        value = self.fields.get(key)
        if value is not None and (type(value) not in (int, float) or value % 1 or not low <= value <= _MAX_WHOLE):
            raise self.error(key, f"a whole number from {low} to {_MAX_WHOLE}")
        return None if value is None else int(value)

    def text(self, key: str, default: str) -> str:
        """Return a word."""
        value = self.fields.get(key, default)
        if not isinstance(value, str):
            raise self.error(key, "a word")
        return value

    def disparities(self) -> dict[str, int | None]:
        """Return the range of a pair's disparities, as fields of its scene."""
        low, top = self.whole("min_disparity") or 0, self.whole("max_disparity")
        if top is not None and top <= low:
            raise self.error("max_disparity", f"a number above {low}")
        return {"min_disparity": low, "max_disparity": top}

    def pose(self) -> Pose | None:
        """Return the matrix from the camera's coordinates to the world's below the key ``pose``."""
        value = self.fields.get("pose")
        if value is None:
            return None
        with naming(self.path):
            return pose_of(numbers(value, "pose", (4, 4)))

    def error(self, key: str, wanted: str) -> InputError:
        """Return the error that says that the field ``key`` must be ``wanted``."""
        return InputError(f"{self.path}: {key}: expected {wanted} (got {short(self.fields.get(key))})")


class Layout(ABC):
    """One way to lay out a folder: a row of a table (``layouts.rows``), or a class that reads files of its own."""

    kind: type[Scene]
    wants: str
    """The files of a scene, in a line for messages and the manual."""
    protocol: str = ""
    """Name of the evaluation protocol of its scenes, where the folder names no other."""

    @property
    def name(self) -> str:
        """Name on the command line: its row's or plug-in's, with dashes."""
        return registered_name(type(self)).replace("_", "-")

    @abstractmethod
    def scenes(self, folder: Folder) -> list[Scene]:
        """Return the scenes of ``folder`` itself; none if it is not of this layout."""

    def scene(self, folder: Folder, **values: Any) -> Scene:
        """Return a scene of ``folder`` with these fields; where not given, the name is the folder's."""
        own = {"name": folder.name, "folder": folder.path, "layout": self.name, "protocol": self.protocol, **values}
        return self.kind(**own)


PLUGINS = Registry[Layout](__name__)
"""The layouts of plug-ins; this package's are rows of tables."""


@dataclass(frozen=True)
class Layouts(Generic[SceneT]):
    """The layouts whose scenes are of one kind."""

    kind: type[SceneT]
    rows: tuple[Layout, ...]

    @classmethod
    def of(cls, kind: type[SceneT], *rows: Layout) -> Layouts[SceneT]:
        """Return layouts sorted by name."""
        return cls(kind, tuple(sorted(rows, key=lambda row: row.name)))

    def of_kind(self, kind: type[Scene]) -> Layouts[Any]:
        """Return the layouts of a narrower kind."""
        return Layouts(kind, tuple(row for row in self.rows if issubclass(row.kind, kind)))

    def with_plugins(self) -> Layouts[SceneT]:
        """Return these, then the layouts of plug-ins."""
        added = (PLUGINS.load(name)() for name in PLUGINS.names())
        return replace(self, rows=(*self.rows, *(row for row in added if issubclass(row.kind, self.kind))))


def layout_plugins(scenes: Iterable[Scene]) -> set[Plugin]:
    """Return the plug-ins whose layouts found any of these scenes."""
    names = {scene.layout for scene in scenes}
    return plugins_of(kind for name, kind in PLUGINS.added.items() if name.replace("_", "-") in names)
