"""Named things of one kind: the modules of a package, and what plug-ins add to them.

A plug-in is an object that an installed package offers under an entry point (group ``depthcli.stereo.cost`` for the
package ``depthcli.methods.stereo.cost``; ``groups`` lists all), or a class in a file that :func:`load_file` has read.
Metadata of installed packages are read only where a name is not one of the package's own, or where names are listed.
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
import pkgutil
import re
import sys
import traceback
import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, Generic, TypeVar

from depthcli.core.errors import ConfigError

T = TypeVar("T")

# Rooms of the package, which the names of groups leave out.
_ROOMS = ("methods", "algorithms", "data", "generated", "evaluation")
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


_registries: dict[str, Registry[Any]] = {}
_provided: dict[str, dict[str, str]] = {}  # package -> name -> module elsewhere
_file_plugins: dict[str, list[Plugin]] = {}
_read_files: dict[str, Path] = {}
_plugin_by_class: dict[type, tuple[Registry[Any], Plugin]] = {}


def provide(package: str, *modules: str) -> None:
    """Add modules that lie elsewhere to those of ``package``, each under the last part of its name.

    For objects of our own that need rooms which ``package`` may not import. Nothing is imported until it is used.
    """
    _provided.setdefault(package, {}).update({module.rpartition(".")[2]: module for module in modules})


class Registry(Generic[T]):
    """Named objects of one kind.

    Parameters
    ----------
    package : whose public modules are our own objects
    own : returns the object of one of its modules
    check : returns the object that a plug-in offers, or raises TypeError or ValueError with what is wrong
    bases : modules outside of the package that hold base classes of its objects
    """

    def __init__(
        self, package: str, own: Callable[[ModuleType], T], check: Callable[[Any], T], bases: tuple[str, ...] = ()
    ) -> None:
        self.package, self._own, self._check = package, own, check
        self.group = ".".join(part for part in package.split(".") if part not in _ROOMS)
        _registries.update(dict.fromkeys((package, *bases), self))

    @property
    def own_names(self) -> tuple[str, ...]:
        """The names of our own objects, with underscores, sorted."""
        path = importlib.import_module(self.package).__path__
        names = {module.name for module in pkgutil.iter_modules(path) if not module.name.startswith("_")}
        return tuple(sorted(names.union(_provided.get(self.package, ()))))

    def plugins(self) -> dict[str, Plugin]:
        """Return name -> plug-in, sorted; a name that another one has, too, is written ``package:name``."""
        found = _plugins_in(self.group)
        names = [*self.own_names, *(plugin.name for plugin in found)]
        return {p.qualified if names.count(p.name) > 1 else p.name: p for p in sorted(found, key=lambda p: p.qualified)}

    def names(self) -> list[str]:
        """Return all names, our own first; plug-ins that cannot be loaded are left out, with a warning."""
        usable = []
        for name, plugin in self.plugins().items():
            try:
                self._load_plugin(plugin)
            except ConfigError as error:
                warnings.warn(str(error), PluginWarning, stacklevel=2)
            else:
                usable.append(name)
        return [*self.own_names, *usable]

    def find(self, name: str) -> str | None:
        """Return the name as :meth:`load` takes it, None where there is none.

        Parameters
        ----------
        name : in any case, with dashes or underscores; ``package:name`` for a plug-in of a certain package
        """
        package, _, last = name.rpartition(":")
        plain = last.lower().replace("-", "_").replace(" ", "_")
        if not package and plain in self.own_names:
            return plain
        known = self.plugins()
        for each, plugin in known.items():
            if plain == plugin.name and (package == plugin.package or each == plain):
                return each
        return None

    def load(self, name: str) -> T:
        """Return the object of that name, which :meth:`find` or :meth:`names` gave.

        Raises
        ------
        KeyError
            There is none.
        ConfigError
            It is a plug-in's and cannot be loaded.
        """
        if name in self.own_names:
            module = _provided.get(self.package, {}).get(name, f"{self.package}.{name}")
            return self._own(importlib.import_module(module))
        return self._load_plugin(self.plugins()[name])

    def _load_plugin(self, plugin: Plugin) -> T:
        value = plugin.load()
        try:
            checked = self._check(value)
        except (TypeError, ValueError) as error:
            raise ConfigError(f"plug-in {plugin.name} of {plugin.package} {plugin.version}: {error}") from error
        _plugin_by_class[value if isinstance(value, type) else type(value)] = (self, plugin)
        return checked


def plugin_of(kind: type) -> Plugin | None:
    """Return the plug-in that a class, or the object of that class, came from; None for our own and unknown ones."""
    if kind.__module__.startswith("depthcli."):
        return None
    if kind not in _plugin_by_class:
        reference = f"{kind.__module__}:{kind.__qualname__}"
        for registry in _registries_of(kind):  # a worker process gets objects without having loaded their plug-ins
            for plugin in registry.plugins().values():
                if plugin.reference == reference:
                    _plugin_by_class[kind] = (registry, plugin)
    return _plugin_by_class[kind][1] if kind in _plugin_by_class else None


def registered_name(kind: type) -> str:
    """Return the name of a class, or of the object of that class, in its registry: its module's, or the plug-in's."""
    plugin = plugin_of(kind)
    if plugin is None:
        return kind.__module__.rpartition(".")[2]
    names = _plugin_by_class[kind][0].plugins()
    return next(name for name, each in names.items() if each == plugin)


def plugins_in_use() -> dict[str, Plugin]:
    """Return name, plain and qualified -> plug-in, of those that this process has loaded."""
    return {name: plugin for _, plugin in _plugin_by_class.values() for name in (plugin.name, plugin.qualified)}


def versions_here(plugins: Iterable[Plugin]) -> dict[str, str]:
    """Return package, or file -> version that this process finds, sorted; ``missing`` where it finds none.

    In the process that found the plug-ins these are their own versions; a worker elsewhere may have others.
    """
    found = {}
    for plugin in plugins:
        known = _plugins_in(plugin.group)
        found[plugin.package] = next((p.version for p in known if p.qualified == plugin.qualified), "missing")
    return dict(sorted(found.items()))


def registry_of(kind: type) -> Registry[Any] | None:
    """Return the registry that a class belongs to, by the packages of its base classes; None where there is none."""
    return next(_registries_of(kind), None)


def registry_in(package: str) -> Registry[Any] | None:
    """Return the registry that a package declared when it was imported; None where it has none."""
    return _registries.get(package)


def _registries_of(kind: type) -> Iterator[Registry[Any]]:
    for base in kind.__mro__:
        package = base.__module__
        while package:
            if package in _registries:
                yield _registries[package]
            package = package.rpartition(".")[0]


def groups() -> dict[str, str]:
    """Return group of entry points -> package that it adds to, of the registries that are known by now."""
    return {registry.group: registry.package for registry in _registries.values()}


def _plugins_in(group: str) -> tuple[Plugin, ...]:
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


def _classes(module: ModuleType) -> Iterator[type]:
    for value in vars(module).values():
        own = isinstance(value, type) and value.__module__ == module.__name__
        if own and not value.__name__.startswith("_") and not inspect.isabstract(value):
            yield value


def _plugins_of(kind: type, file: str, version: str) -> Iterator[Plugin]:
    registry = registry_of(kind)
    if registry is not None:
        name = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", kind.__name__).lower()
        yield Plugin(name, registry.group, file, version, f"{kind.__module__}:{kind.__qualname__}")


class _FileFinder:
    """Finds the modules of plug-in files, in this process and in its workers."""

    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> importlib.machinery.ModuleSpec | None:
        file = next((file for file in _files() if _module_name(file) == name), None)
        return None if file is None else importlib.util.spec_from_file_location(name, file)


sys.meta_path.append(_FileFinder)
