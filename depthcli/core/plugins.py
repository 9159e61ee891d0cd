"""Plug-ins: objects that installed packages and files of users add to registries.

An installed package offers them under entry points, one group a registry (``depthcli.stereo.cost``), of which the
metadata are read; a file of a user is read by :func:`load_file`, and its classes are plug-ins. What they are is decided
by the registries that :func:`declare` their packages here.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import importlib.machinery
import importlib.util
import inspect
import operator
import os
import re
import sys
import traceback
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

from depthcli.core.errors import ConfigError

# Modules of files are called so, with the file's name behind it; worker processes find the files in the variable.
_FILE_MODULE = "depthcli_plugin_"
_FILES_VARIABLE = "DEPTHCLI_PLUGIN_FILES"


class PluginWarning(UserWarning):
    """A plug-in cannot be used; the program goes on without it."""


@dataclass(frozen=True)
class Plugin:
    """What a package, or a file, adds to a registry.

    Attributes
    ----------
    name : of the object, with underscores
    group : of the registry, ``depthcli.stereo.cost``
    package, version : of the distribution; the file's name and the start of its SHA-256 digest for a file
    reference : ``module:attribute``
    """

    name: str
    group: str
    package: str
    version: str
    reference: str

    @property
    def qualified(self) -> str:
        """The name that is unique among all packages, ``package:name``."""
        return f"{self.package}:{self.name}"

    @property
    def is_file(self) -> bool:
        """Return whether it is a class of a file, not of an installed package."""
        return self.reference.startswith(_FILE_MODULE)

    def load(self) -> Any:
        """Return the object.

        Raises
        ------
        ConfigError
            It cannot be imported; the message names the package.
        """
        try:
            module, _, attribute = self.reference.partition(":")
            return operator.attrgetter(attribute)(importlib.import_module(module))
        except Exception as error:  # a stranger's code may raise anything
            why = (str(error).splitlines() or [""])[0]
            raise ConfigError(
                f"plug-in {self.name} of {self.package} {self.version} cannot be loaded: {type(error).__name__}: {why}"
            ) from error


_groups: dict[str, str] = {}  # by package
_file_plugins: dict[str, list[Plugin]] = {}  # by group
_read_files: dict[str, Path] = {}


def declare(group: str, *packages: str) -> None:
    """Say that classes whose base classes lie in these packages, or modules, belong to a group."""
    _groups.update(dict.fromkeys(packages, group))


def groups_of(kind: type) -> Iterator[str]:
    """Yield the groups that a class may belong to, by the packages of its base classes, the nearest first."""
    for base in kind.__mro__:
        package = base.__module__
        while package:
            if package in _groups:
                yield _groups[package]
            package = package.rpartition(".")[0]


def plugins_in(group: str) -> tuple[Plugin, ...]:
    """Return the plug-ins of files and of installed packages that add to a group."""
    for path in _files():  # in a worker process they are not read yet
        load_file(path)
    return (*_file_plugins.get(group, ()), *_installed(group))


@cache
def _installed(group: str) -> tuple[Plugin, ...]:
    if not _is_any_installed():
        return ()
    from importlib import metadata  # with email, zipfile and csv: 40 ms that a run without plug-ins does without

    found = set()
    for entry in metadata.entry_points(group=group):
        if entry.dist is not None:
            name = entry.name.lower().replace("-", "_")
            found.add(Plugin(name, group, entry.dist.name, entry.dist.version, entry.value))
    return tuple(sorted(found, key=lambda plugin: plugin.qualified))


def is_installed(package: str) -> bool:
    """Return whether a distribution of that name is installed."""
    from importlib import metadata  # as above

    try:
        metadata.distribution(package)
    except (metadata.PackageNotFoundError, ValueError):
        return False
    return True


@cache
def _is_any_installed() -> bool:
    """Return whether any installed package may have entry points of a group of ours, by a look at their files."""
    for folder in sys.path:
        try:
            with os.scandir(folder or ".") as entries:
                found = [entry.path for entry in entries if entry.name.endswith((".dist-info", ".egg-info"))]
        except OSError:
            if os.path.isfile(folder):  # an archive: not looked into
                return True
            continue
        for path in found:
            with contextlib.suppress(OSError):
                if b"[depthcli." in Path(path, "entry_points.txt").read_bytes():
                    return True
    return False


def load_file(path: Path) -> None:
    """Read a Python file and register the classes in it that belong to a registry, under their names in snake case.

    A class belongs to the registry in whose package a base class of it lies; abstract ones, and those whose name
    begins with an underscore, are left out. Worker processes that are started later read the file, too.

    Raises
    ------
    ConfigError
        The file cannot be read or run, or holds nothing that belongs to a registry.
    """
    path = Path(os.path.abspath(path))
    name = _module_name(path)
    if name in _read_files:
        if _read_files[name] != path:
            raise ConfigError(f"{path}: a plug-in file of that name is in use already ({_read_files[name]})")
        return
    try:
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise ConfigError(f"{path}: plug-in cannot be read ({error.strerror or error})") from error
    earlier = _files()
    os.environ[_FILES_VARIABLE] = os.pathsep.join(map(str, dict.fromkeys([*earlier, path])))
    _read_files[name] = path
    try:
        module = importlib.import_module(name)
        plugins = [plugin for kind in _classes(module) for plugin in _plugins_of(kind, path.name, digest[:12])]
        if not plugins:
            raise ConfigError(f"{path}: holds no method, layout, protocol, command or the like; want a subclass of one")
    except BaseException as error:
        os.environ[_FILES_VARIABLE] = os.pathsep.join(map(str, earlier))
        del _read_files[name]
        sys.modules.pop(name, None)
        if isinstance(error, ConfigError) or not isinstance(error, Exception):
            raise
        lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
        why = (str(error).splitlines() or [""])[0]
        place = f"{path}:{lines[-1]}" if lines else str(path)
        raise ConfigError(f"{place}: plug-in cannot be loaded: {type(error).__name__}: {why}") from error
    for plugin in plugins:
        _file_plugins.setdefault(plugin.group, []).append(plugin)


def is_file_loaded(name: str) -> bool:
    """Return whether a plug-in file of that name has been read."""
    return any(path.name == name for path in _read_files.values())


def _files() -> list[Path]:
    return [Path(file) for file in os.environ.get(_FILES_VARIABLE, "").split(os.pathsep) if file]


def _module_name(path: Path) -> str:
    return _FILE_MODULE + re.sub(r"\W", "_", path.stem)


def _classes(module: ModuleType) -> Iterator[Any]:
    """Yield the public classes of a module that are not abstract, and the functions that name a group themselves."""
    for value in vars(module).values():
        own = isinstance(value, type) or hasattr(value, "plugin_group")
        if own and value.__module__ == module.__name__ and value.__name__[0] != "_" and not inspect.isabstract(value):
            yield value


def _plugins_of(kind: Any, file: str, version: str) -> Iterator[Plugin]:
    group = next(groups_of(kind), None) if isinstance(kind, type) else kind.plugin_group
    if group is not None:
        name = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", kind.__name__).lower()
        yield Plugin(name, group, file, version, f"{kind.__module__}:{kind.__qualname__}")


class _FileFinder:
    """Finds the modules of plug-in files, in this process and in its workers."""

    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> importlib.machinery.ModuleSpec | None:
        file = next((file for file in _files() if _module_name(file) == name), None)
        return None if file is None else importlib.util.spec_from_file_location(name, file)


sys.meta_path.append(_FileFinder)
