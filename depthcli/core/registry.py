"""Named things of one kind: the modules of a package, and what plug-ins add to them.

A plug-in (see ``plugins``) is looked for only where a name is not one of the package's own, or where names are listed.
"""

from __future__ import annotations

import importlib
import pkgutil
import warnings
from collections.abc import Callable, Iterable, Iterator
from types import ModuleType
from typing import Any, Generic, TypeVar

from depthcli.core.errors import ConfigError
from depthcli.core.plugins import Plugin, PluginWarning, declare, groups_of, plugins_in

T = TypeVar("T")

# Rooms of the package, which the names of groups leave out.
_ROOMS = ("methods", "algorithms", "io", "simulate", "evaluation")

_registries: dict[str, Registry[Any]] = {}  # by group
_plugin_by_class: dict[type, tuple[Registry[Any], Plugin]] = {}


def plain_name(name: str) -> str:
    """Return a name in lower case, with underscores for dashes and spaces."""
    return name.lower().replace("-", "_").replace(" ", "_")


class Registry(Generic[T]):
    """Named objects of one kind.

    Parameters
    ----------
    package : whose public modules are our own objects
    own : returns the object of one of its modules
    check : returns the object that a plug-in offers, or raises TypeError or ValueError with what is wrong
    bases : modules outside of the package that hold base classes of its objects
    group : of entry points; by default the package without the names of rooms
    """

    def __init__(
        self,
        package: str,
        own: Callable[[ModuleType], T],
        check: Callable[[Any], T],
        bases: tuple[str, ...] = (),
        group: str = "",
    ) -> None:
        self.package, self._own, self._check = package, own, check
        self.group = group or ".".join(part for part in package.split(".") if part not in _ROOMS)
        _registries[self.group] = self
        declare(self.group, package, *bases)

    @property
    def own_names(self) -> tuple[str, ...]:
        """The names of our own objects, with underscores, sorted."""
        path = importlib.import_module(self.package).__path__
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

        Our own names come first, then their aliases, then the names of plug-ins, then their aliases: a plug-in that is
        installed does not change what a config means.

        Parameters
        ----------
        name : in any case, with dashes or underscores; ``package:name`` for a plug-in of a certain package
        """
        package, _, last = name.rpartition(":")
        plain = plain_name(last)
        if not package and plain in self.own_names:
            return plain
        if not package and (known := self._find_alias(plain, self.own_names)) is not None:
            return known
        plugins = self.plugins()
        for each, plugin in plugins.items():
            if plain == plugin.name and (package == plugin.package or each == plain):
                return each
        return None if package or not plugins else self._find_alias(plain, self.names())

    def _find_alias(self, plain: str, names: Iterable[str]) -> str | None:
        """Return the first of ``names`` whose object is also called ``plain``; objects have one name, methods more."""
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
            return self._own(importlib.import_module(f"{self.package}.{name}"))
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


def with_package(kind: type, about: str) -> str:
    """Return what is said of a class, behind the package and version of the plug-in that it came from."""
    plugin = plugin_of(kind)
    return about if plugin is None else f"({plugin.package} {plugin.version}) {about}"


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
        known = plugins_in(plugin.group)
        found[plugin.package] = next((p.version for p in known if p.qualified == plugin.qualified), "missing")
    return dict(sorted(found.items()))


def registry_of(kind: type) -> Registry[Any] | None:
    """Return the registry that a class belongs to, by the packages of its base classes; None where there is none."""
    return next(_registries_of(kind), None)


def registry_in(package: str) -> Registry[Any] | None:
    """Return the registry that a package declared when it was imported; None where it has none."""
    return next((registry for registry in _registries.values() if registry.package == package), None)


def _registries_of(kind: type) -> Iterator[Registry[Any]]:
    return (_registries[group] for group in groups_of(kind))


def groups() -> dict[str, str]:
    """Return group of entry points -> package that it adds to, of the registries that are known by now."""
    return {group: registry.package for group, registry in _registries.items()}
