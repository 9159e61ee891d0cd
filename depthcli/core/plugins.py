"""Registries of named classes, one in each module of a package, and plug-ins, which add others.

Plug-ins are Python files and installed modules that ``--plugin``, or the key ``plugins`` of a config, names. One adds
public classes derived from a base in a registry's package, functions with the decorator ``depthcli.commands.command``,
and the files ``presets/COMMAND/NAME.yaml`` next to it. A process loads plug-ins before it unpickles such objects.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import importlib.util
import inspect
import os
import pkgutil
import re
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from operator import attrgetter
from pathlib import Path
from types import ModuleType
from typing import Any, Generic, TypeVar

from depthcli.core.errors import ConfigError, Terminated

T = TypeVar("T")

registries: dict[str, Registry[Any]] = {}
"""Package -> the registry that it declared when it was imported."""


class Registry(Generic[T]):
    """Named classes derived from a base class that their package defines; its public modules have one each."""

    def __init__(self, package: str) -> None:
        self.package = package
        self.added: dict[str, type[T]] = {}  # classes of plug-ins
        self._own: dict[str, type[T]] = {}  # that were loaded
        registries[package] = self

    @cached_property
    def own_names(self) -> tuple[str, ...]:
        """The names of our own classes, with underscores, sorted."""
        path = getattr(sys.modules[self.package], "__path__", ())
        return tuple(sorted(module.name for module in pkgutil.iter_modules(path) if not module.name.startswith("_")))

    def names(self) -> list[str]:
        """Return all names, our own first."""
        return [*self.own_names, *sorted(self.added)]

    def find(self, name: str) -> str | None:
        """Return the name for :meth:`load`, or None if it is unknown; case, dashes and underscores do not matter.

        Our own names and their aliases have precedence, so that a plug-in does not change the meaning of a config.
        """
        plain = plain_name(name)
        if plain in self.own_names:
            return plain
        return self._find_alias(plain, self.own_names) or (
            plain if plain in self.added else self._find_alias(plain, sorted(self.added))
        )

    def _find_alias(self, plain: str, names: Iterable[str]) -> str | None:
        aliases = ((name, getattr(self.load(name), "aliases", ())) for name in names)
        return next((name for name, others in aliases if plain in map(plain_name, others)), None)

    def load(self, name: str) -> type[T]:
        """Return the class of a name from :meth:`find` or :meth:`names`."""
        if name not in self.added and name not in self._own:
            self._own[name] = self._class_in(importlib.import_module(f"{self.package}.{name}"))
        return self.added.get(name) or self._own[name]

    def _class_in(self, module: ModuleType) -> type[T]:
        own = [v for v in vars(module).values() if isinstance(v, type) and v.__module__ == module.__name__]
        found = [v for v in own if registry_of(v) is self]
        if len(found) != 1:
            names = " and ".join(v.__name__ for v in found) or "no class"
            raise TypeError(f"{module.__name__} defines {names}; a file of this folder has one class of its family")
        return found[0]

    def add(self, kind: type[T]) -> None:
        """Add a class of a plug-in. Raise ValueError if its name is taken."""
        name = registered_name(kind)
        if self.find(name) is not None:
            raise ValueError(f"class {kind.__name__}: there is a {name!r} in {self.package} already")
        self.added[name] = kind


def plain_name(name: str) -> str:
    """Return a name in lower case, with underscores for dashes and spaces."""
    return name.lower().replace("-", "_").replace(" ", "_")


def registry_of(kind: type) -> Registry[Any] | None:
    """Return the registry of a class, by the modules of its base classes, or None."""
    for base in kind.__mro__:
        if base.__module__ in registries:
            return registries[base.__module__]
    return None


def registered_name(kind: type) -> str:
    """Return the name of a class in its registry: its module's name, or a plug-in's class name in snake case."""
    if kind.__module__.startswith("depthcli."):
        return kind.__module__.rpartition(".")[2]
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", kind.__name__).lower()


@dataclass(frozen=True)
class Plugin:
    """A file or an installed module that adds classes, commands and presets."""

    source: str  # absolute path of the file, or name of the module
    module: str  # key in ``sys.modules``
    folder: Path  # of the file, or of the module
    package: str  # name of the file, or of the distribution
    version: str  # start of the SHA-256 digest of the file, or version of the distribution

    @property
    def is_file(self) -> bool:
        """True for a file, which other machines do not have."""
        return self.source != self.module

    @property
    def root(self) -> str:
        """First part of the names of its modules."""
        return self.module.partition(".")[0]


loaded: dict[str, Plugin] = {}
"""Name of a module -> its plug-in, for all loaded ones."""
commands: dict[str, Callable[..., int]] = {}
"""Name -> function of the commands of plug-ins."""


def load_plugin(name: str, folder: Path = Path()) -> None:
    """Load a plug-in, a file ``NAME.py`` in ``folder`` or an installed module, unless it is loaded already.

    Raise ConfigError if it cannot be imported, adds nothing, or adds a name that is taken.
    """
    source = module = name
    if name.endswith(".py"):
        source, module = os.path.abspath(folder / name), "depthcli_plugin_" + re.sub(r"\W", "_", Path(name).stem)
    if module in loaded:
        if loaded[module].source != source:
            raise ConfigError(f"{source}: a plug-in file of that name is in use already ({loaded[module].source})")
        return
    try:
        modules = list(_imported(module, source))
        loaded[module] = plugin = _described(modules[0], source)
        added = [_add(value) for part in modules for value in _public(part)]
        if not any(added) and not (plugin.folder / "presets").is_dir():
            raise TypeError("it has no command, and no subclass of a method, layout, protocol or the like")
    except (KeyboardInterrupt, Terminated):
        raise
    except BaseException as error:  # a stranger's code may raise anything, or exit
        forget(module)
        places = [f"{file}:{line}" for root, file, line in _frames(error) if root == module.partition(".")[0]]
        reason = f"{type(error).__name__}: {(str(error).splitlines() or [''])[0]}"
        raise ConfigError(f"{places[-1] if places else source}: plug-in cannot be loaded: {reason}") from error


def forget(module: str) -> None:
    """Remove the plug-in of a module and its additions from this process."""
    loaded.pop(module, None)
    sys.modules.pop(module, None)
    kinds: list[dict[str, Any]] = [commands, *(registry.added for registry in registries.values())]
    for added in kinds:
        for name in [name for name, value in added.items() if f"{value.__module__}.".startswith(f"{module}.")]:
            del added[name]


def plugins_of(kinds: Iterable[type]) -> set[Plugin]:
    """Return the plug-ins of classes; our own have none."""
    roots = {kind.__module__.partition(".")[0] for kind in kinds}
    return {plugin for plugin in loaded.values() if plugin.root in roots}


def plugin_behind(error: BaseException) -> str:
    """Return the plug-in in the traceback of an error, with file and line, or an empty text."""
    plugins = {plugin.root: plugin for plugin in loaded.values()}
    for root, file, line in reversed(_frames(error)):
        if root in plugins:
            return f"{plugins[root].package} {plugins[root].version} ({Path(file).name}:{line})"
    return ""


def versions_here(plugins: Iterable[Plugin]) -> dict[str, str]:
    """Return package or file -> loaded version, sorted."""
    return {each.package: loaded[each.module].version for each in sorted(plugins, key=attrgetter("package"))}


def _imported(name: str, source: str) -> Iterator[ModuleType]:
    """Import and yield the module of a file, or the installed module ``name`` and all public modules in it."""
    if name == source:
        module = importlib.import_module(name)
    else:
        spec = importlib.util.spec_from_file_location(name, source)
        assert spec is not None and spec.loader is not None  # the file's name ends with .py
        sys.modules[name] = module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    yield module
    for part in pkgutil.iter_modules(getattr(module, "__path__", ())):
        if not part.name.startswith("_"):
            yield from _imported(f"{name}.{part.name}", f"{name}.{part.name}")


def _described(module: ModuleType, source: str) -> Plugin:
    """Return the plug-in of a module; without a distribution its version is the digest of its files."""
    name, places = module.__name__, list(getattr(module, "__path__", ()))
    folder = Path(places[0] if places else os.path.dirname(module.__file__ or ""))
    if name == source:
        from importlib import metadata  # takes 40 ms

        with contextlib.suppress(metadata.PackageNotFoundError):
            distribution = metadata.distribution(name.partition(".")[0])
            return Plugin(source, name, folder, distribution.name, distribution.version)
    files = sorted(folder.rglob("*.py")) if places else [Path(module.__file__ or "")]
    digest = hashlib.sha256(b"".join(file.read_bytes() for file in files))
    return Plugin(source, name, folder, Path(source).name, digest.hexdigest()[:12])


def _public(module: ModuleType) -> set[Any]:
    """Return the public classes and functions that a module defines."""
    kinds = {value for value in vars(module).values() if inspect.isclass(value) or inspect.isfunction(value)}
    return {kind for kind in kinds if kind.__module__ == module.__name__ and not kind.__name__.startswith("_")}


def _add(value: Any) -> bool:
    """Register a class or command; return whether the value is one. Raise ValueError if its name is taken."""
    if getattr(value, "is_command", False):
        name = value.__name__.replace("_", "-")
        if name in commands:
            raise ValueError(f"there is a command {name} already, of {commands[name].__module__}")
        commands[name] = value
        return True
    registry = registry_of(value) if inspect.isclass(value) and not inspect.isabstract(value) else None
    if registry is not None:
        registry.add(value)
    return registry is not None


def _frames(error: BaseException) -> list[tuple[str, str, int]]:
    """Return top-level package, file and line of each call in an error's traceback."""
    calls = traceback.walk_tb(error.__traceback__)
    return [(f.f_globals.get("__name__", "").partition(".")[0], f.f_code.co_filename, line) for f, line in calls]
