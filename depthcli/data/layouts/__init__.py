"""Layouts: how people lay out folders of data, one file a layout; the folder is the registry."""

from __future__ import annotations

import importlib
import json
import os
import pkgutil
from abc import ABC, abstractmethod
from collections.abc import Iterable
from functools import cache, cached_property
from pathlib import Path
from typing import Any, ClassVar

from depthcli.core.errors import InputError
from depthcli.core.yaml_source import short
from depthcli.data.formats.files import read_bytes
from depthcli.data.scenes import Scene


class Folder:
    """One folder as a layout sees it: names only, nothing in it is opened.

    Attributes
    ----------
    path : where it is
    name : name of a scene that is the folder itself
    prefix : what the names of scenes inside begin with
    requested : the layout that the user named, or empty
    """

    def __init__(self, path: Path, name: str, prefix: str, requested: str = "") -> None:
        self.path, self.name, self.prefix, self.requested = path, name, prefix, requested
        try:
            with os.scandir(path) as entries:
                self.names = frozenset(entry.name for entry in entries if not entry.name.startswith("."))
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error

    def has(self, *names: str) -> bool:
        """Return whether all of the names are there."""
        return set(names) <= self.names

    def one(self, stem: str, suffixes: Iterable[str]) -> Path | None:
        """Return the file of that stem; InputError where several endings compete."""
        fitting = [name for name in self._by_stem.get(stem, ()) if Path(name).suffix.lower() in suffixes]
        if len(fitting) > 1:
            raise InputError(f"{self.path}: both {fitting[0]} and {fitting[1]}; keep one")
        return self.path / fitting[0] if fitting else None

    def starting(self, start: str, suffixes: Iterable[str]) -> dict[str, Path]:
        """Return what follows ``start`` in the stem -> file."""
        files = {}
        for stem in sorted(self._by_stem):
            file = self.one(stem, suffixes) if stem.startswith(start) else None
            if file is not None:
                files[stem.removeprefix(start)] = file
        return files

    @cached_property
    def _by_stem(self) -> dict[str, list[str]]:
        by_stem: dict[str, list[str]] = {}
        for name in sorted(self.names):
            by_stem.setdefault(Path(name).stem, []).append(name)
        return by_stem

    def meta(self) -> dict[str, Any]:
        """Return the fields of ``meta.json`` that have a value; empty where there is no such file."""
        path = self.path / "meta.json"
        if path.name not in self.names:
            return {}
        try:
            meta = json.loads(read_bytes(path).decode("utf-8"))
        except (ValueError, RecursionError) as error:
            raise InputError(f"{path}: not valid JSON ({error})") from error
        if not isinstance(meta, dict):
            raise InputError(f"{path}: want a JSON object, got {type(meta).__name__}")
        return {key: value for key, value in meta.items() if value is not None}

    def positive(self, meta: dict[str, Any], key: str, limit: float = 1e6) -> float | None:
        """Return a positive number of ``meta.json``, or None where it has none."""
        value = meta.get(key)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < limit:
            raise InputError(f"{self.path / 'meta.json'}: {key}: want a positive number (got {short(value)})")
        return float(value)

    def whole(self, meta: dict[str, Any], key: str) -> int | None:
        """Return a positive whole number of ``meta.json``, or None where it has none."""
        value = self.positive(meta, key)
        if value is not None and value != int(value):
            raise InputError(f"{self.path / 'meta.json'}: {key}: want a whole number (got {short(value)})")
        return None if value is None else int(value)

    def integer(self, meta: dict[str, Any], key: str, limit: int = 1 << 20) -> int | None:
        """Return a whole number of either sign of ``meta.json``, or None where it has none."""
        value = meta.get(key)
        if value is not None and (isinstance(value, bool) or not isinstance(value, int | float)
                                  or value != value // 1 or abs(value) > limit):  # fmt: skip
            raise InputError(f"{self.path / 'meta.json'}: {key}: want a whole number (got {short(value)})")
        return None if value is None else int(value)

    def text(self, meta: dict[str, Any], key: str, default: str) -> str:
        """Return a word of ``meta.json``, or ``default``."""
        value = meta.get(key, default)
        if not isinstance(value, str):
            raise InputError(f"{self.path / 'meta.json'}: {key}: want a word (got {short(value)})")
        return value


class Layout(ABC):
    """One way to lay out a folder; subclasses are found by their file."""

    kind: ClassVar[type[Scene]]
    wants: ClassVar[str]
    """The files of a scene, in a line for messages and the manual."""

    @property
    def name(self) -> str:
        """Name on the command line: its module's, with dashes."""
        return type(self).__module__.rpartition(".")[2].replace("_", "-")

    @abstractmethod
    def scenes(self, folder: Folder) -> list[Scene]:
        """Return the scenes that ``folder`` itself holds; none where it is not of this layout.

        Raises
        ------
        InputError
            It is of this layout, but cannot be used.
        """


@cache
def layouts() -> tuple[Layout, ...]:
    """Return every layout, sorted by name."""
    known = []
    for module in sorted(pkgutil.iter_modules(__path__), key=lambda m: m.name):
        if module.name.startswith("_"):
            continue
        loaded = importlib.import_module(f"{__name__}.{module.name}")
        own = [v for v in vars(loaded).values() if isinstance(v, type) and v.__module__ == loaded.__name__]
        (layout,) = (v for v in own if issubclass(v, Layout))
        known.append(layout())
    return tuple(known)
