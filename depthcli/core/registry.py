"""Named classes of one kind: one in each module of a package, and those that plug-ins add.

An installed package offers plug-ins as entry points, one group a registry (``depthcli.stereo.cost``); a file of a user
is read by :func:`load_file`, and every class in it that derives from one of a registry's package is a plug-in. They are
looked for only where a name is not one of the package's own, or where names are listed.
"""

from __future__ import annotations

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
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Generic, TypeVar

from depthcli.core.errors import ConfigError, Terminated

T = TypeVar("T")

_ROOMS = ("methods", "algorithms", "io", "simulate", "evaluation")  # the names of groups leave them out
_FILE_MODULE = "depthcli_plugin_"  # the module of a file is called so, with the file's name behind it
_FILES_VARIABLE = "DEPTHCLI_PLUGIN_FILES"  # worker processes find the files there

registries: dict[str, Registry[Any]] = {}
"""Package -> the registry that it declared when it was imported."""
_file_plugins: dict[Path, list[Plugin]] = {}  # of every file that was read
_plugin_by_class: dict[type, Plugin] = {}


class PluginWarning(UserWarning):
    """A plug-in cannot be used; the program goes on without it."""


@dataclass(frozen=True)
class Plugin:
    """A class, or a command, that a package or a file adds."""

    name: str  # of the class, with underscores
    group: str  # of the registry, such as depthcli.stereo.cost
    package: str  # the distribution, or the file's name
    version: str  # of the distribution, or the start of the file's SHA-256 digest
    reference: str  # module:attribute

    @property
    def qualified(self) -> str:
        """The name that is unique among all packages, ``package:name``."""
        return f"{self.package}:{self.name}"

    @property
    def is_file(self) -> bool:
        """Return whether it is a class of a file, not of an installed package."""
        return self.reference.startswith(_FILE_MODULE)

    def load(self) -> Any:
        """Return the object; ConfigError, which names the package, where its import fails."""
        module, _, attribute = self.reference.partition(":")
        try:
            return operator.attrgetter(attribute)(importlib.import_module(module))
        except (KeyboardInterrupt, Terminated):
            raise
        except BaseException as error:  # a stranger's code may raise anything, or want to exit
            raise ConfigError(f"{self} cannot be loaded: {_reason(error)}") from error

    def __str__(self) -> str:
        return f"plug-in {self.name} of {self.package} {self.version}"


class Registry(Generic[T]):
    """Named classes of one kind, each derived from a base class that their package defines.

    Public modules of the package hold our own classes, one each; ``group`` is that of entry points, by default the
    package without the names of rooms.
    """

    def __init__(self, package: str, group: str = "") -> None:
        self.package = package
        self.group = group or ".".join(part for part in package.split(".") if part not in _ROOMS)
        registries[package] = self

    @property
    def own_names(self) -> tuple[str, ...]:
        """The names of our own classes, with underscores, sorted."""
        path = getattr(importlib.import_module(self.package), "__path__", ())
        return tuple(sorted(module.name for module in pkgutil.iter_modules(path) if not module.name.startswith("_")))

    def plugins(self) -> dict[str, Plugin]:
        """Return name -> plug-in, sorted; a name that another one has, too, is written ``package:name``."""
        found = plugins_in(self.group)
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

        The name is in any case, with dashes or underscores; ``package:name`` is a plug-in of a certain package. Our own
        names come first, then their aliases, then the names of plug-ins, then their aliases: a plug-in that is
        installed does not change what a config means.
        """
        package, _, last = name.rpartition(":")
        plain, plugins = plain_name(last), self.plugins()
        if package:
            return next((n for n, p in plugins.items() if p.name == plain and p.package == package), None)
        known = plain if plain in self.own_names else self._find_alias(plain, self.own_names)
        if known is None and plugins:
            known = plain if plain in plugins else self._find_alias(plain, self.names())
        return known

    def _find_alias(self, plain: str, names: Iterable[str]) -> str | None:
        aliases = ((name, getattr(self.load(name), "aliases", ())) for name in names)
        return next((name for name, others in aliases if plain in map(plain_name, others)), None)

    def load(self, name: str) -> type[T]:
        """Return the class of a name that :meth:`find` or :meth:`names` gave; ConfigError for a broken plug-in's."""
        if name not in self.own_names:
            return self._load_plugin(self.plugins()[name])
        module = importlib.import_module(f"{self.package}.{name}")
        own = [v for v in vars(module).values() if isinstance(v, type) and v.__module__ == module.__name__]
        found = [v for v in own if any(base.__module__ == self.package for base in v.__mro__)]
        if len(found) != 1:
            names = " and ".join(v.__name__ for v in found) or "no class"
            raise TypeError(f"{module.__name__} defines {names}; a file of this folder holds one class of its family")
        return found[0]

    def _load_plugin(self, plugin: Plugin) -> type[T]:
        loaded: type[T] = plugin.load()
        if not isinstance(loaded, type) or registry_of(loaded) is not self:
            raise ConfigError(f"{plugin}: expected a class derived from one of {self.package}, got {loaded!r}")
        _plugin_by_class[loaded] = plugin
        return loaded


def plain_name(name: str) -> str:
    """Return a name in lower case, with underscores for dashes and spaces."""
    return name.lower().replace("-", "_").replace(" ", "_")


def registry_of(kind: type) -> Registry[Any] | None:
    """Return the registry that a class belongs to, by the packages of its base classes; None where there is none."""
    for base in kind.__mro__:
        parts = base.__module__.split(".")
        for size in range(len(parts), 0, -1):
            if found := registries.get(".".join(parts[:size])):
                return found
    return None


def plugin_of(kind: type) -> Plugin | None:
    """Return the plug-in that a class came from; None for our own and unknown ones."""
    if kind not in _plugin_by_class and not kind.__module__.startswith("depthcli."):
        registry, reference = registry_of(kind), f"{kind.__module__}:{kind.__qualname__}"
        for plugin in registry.plugins().values() if registry else ():  # a worker process got an object of the class
            if plugin.reference == reference:
                _plugin_by_class[kind] = plugin
    return _plugin_by_class.get(kind)


def registered_name(kind: type) -> str:
    """Return the name of a class in its registry: its module's, or the plug-in's."""
    plugin, registry = plugin_of(kind), registry_of(kind)
    if plugin is None or registry is None:
        return kind.__module__.rpartition(".")[2]
    return next(name for name, each in registry.plugins().items() if each == plugin)


def plugins_in_use() -> dict[str, Plugin]:
    """Return name, plain and qualified -> plug-in, of those that this process has loaded."""
    return {name: plugin for plugin in _plugin_by_class.values() for name in (plugin.name, plugin.qualified)}


def plugin_behind(error: BaseException) -> str:
    """Return the plug-in whose code raised an error, or called what did, with file and line; else an empty text."""
    roots = dict[str, Plugin]()
    for group in ("depthcli.commands", *(registry.group for registry in list(registries.values()))):
        roots |= {re.split("[.:]", plugin.reference)[0]: plugin for plugin in plugins_in(group)}
    for frame, line in reversed(list(traceback.walk_tb(error.__traceback__))):
        plugin = roots.get(frame.f_globals.get("__name__", "").partition(".")[0])
        if plugin is not None:
            return f"{plugin.package} {plugin.version} ({Path(frame.f_code.co_filename).name}:{line})"
    return ""


def versions_here(plugins: Iterable[Plugin]) -> dict[str, str]:
    """Return package, or file -> version that this process finds, sorted; ``missing`` where it finds none.

    In the process that found the plug-ins these are their own versions; a worker elsewhere may have others.
    """
    found = {}
    for plugin in plugins:
        known = plugins_in(plugin.group)
        found[plugin.package] = next((p.version for p in known if p.qualified == plugin.qualified), "missing")
    return dict(sorted(found.items()))


def plugins_in(group: str) -> tuple[Plugin, ...]:
    """Return the plug-ins of files and of installed packages that add to a group."""
    for path in _files():  # in a worker process they are not read yet
        load_file(path)
    of_files = [plugin for plugins in _file_plugins.values() for plugin in plugins if plugin.group == group]
    return (*of_files, *_installed(group))


@cache
def _installed(group: str) -> tuple[Plugin, ...]:
    # The import of ``metadata`` takes 40 ms, which --help does without where no package has a plug-in.
    named = (file for folder in sys.path for file in Path(folder).glob("*-info/entry_points.txt"))
    if not any(b"[depthcli." in file.read_bytes() for file in named):
        return ()
    from importlib import metadata

    entries = [(entry, entry.dist) for entry in metadata.entry_points(group=group) if entry.dist is not None]
    found = {Plugin(plain_name(entry.name), group, of.name, of.version, entry.value) for entry, of in entries}
    return tuple(sorted(found, key=lambda plugin: plugin.qualified))


def load_file(path: Path) -> None:
    """Read a Python file and register what is in it under its name in snake case.

    That are classes with a base class of a registry's package, and functions that name a group themselves
    (``plugin_group``: commands). Abstract classes, and names that begin with an underscore, are left out. Worker
    processes that are started later read the file, too. ConfigError where it cannot be read or run, or holds nothing
    that belongs to a registry.
    """
    path = Path(os.path.abspath(path))
    name, before = _module_name(path), os.environ.get(_FILES_VARIABLE, "")
    if path in _file_plugins:
        return
    if other := next((file for file in _file_plugins if _module_name(file) == name), None):
        raise ConfigError(f"{path}: a plug-in file of that name is in use already ({other})")
    os.environ[_FILES_VARIABLE] = os.pathsep.join(map(str, dict.fromkeys([*_files(), path])))
    _file_plugins[path] = []
    try:
        version = hashlib.sha256(path.read_bytes()).hexdigest()[:12]
        values = list(vars(importlib.import_module(name)).values())
        for kind in [value for value in values if getattr(value, "__module__", "") == name]:
            registry = registry_of(kind) if isinstance(kind, type) else None
            group = registry.group if registry else getattr(kind, "plugin_group", None)
            if group is not None and not kind.__name__.startswith("_") and not inspect.isabstract(kind):
                snake = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", kind.__name__).lower()
                _file_plugins[path].append(Plugin(snake, group, path.name, version, f"{name}:{kind.__qualname__}"))
        if not _file_plugins[path]:
            raise TypeError("it holds no command, and no subclass of a method, layout, protocol or the like")
    except (KeyboardInterrupt, Terminated):
        raise
    except BaseException as error:  # a stranger's code may raise anything, or want to exit
        os.environ[_FILES_VARIABLE] = before
        del _file_plugins[path]
        sys.modules.pop(name, None)
        lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
        place = f"{path}:{lines[-1]}" if lines else str(path)
        raise ConfigError(f"{place}: plug-in cannot be loaded: {_reason(error)}") from error


def is_file_loaded(name: str) -> bool:
    """Return whether a plug-in file of that name has been read."""
    return any(path.name == name for path in _file_plugins)


def _files() -> list[Path]:
    return [Path(file) for file in os.environ.get(_FILES_VARIABLE, "").split(os.pathsep) if file]


def _module_name(path: Path) -> str:
    return _FILE_MODULE + re.sub(r"\W", "_", path.stem)


def _reason(error: BaseException) -> str:
    return f"{type(error).__name__}: {(str(error).splitlines() or [''])[0]}"


class _FileFinder:
    """Finds the modules of plug-in files, in this process and in its workers."""

    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> importlib.machinery.ModuleSpec | None:
        file = next((file for file in _files() if _module_name(file) == name), None)
        return None if file is None else importlib.util.spec_from_file_location(name, file)


sys.meta_path.append(_FileFinder)
