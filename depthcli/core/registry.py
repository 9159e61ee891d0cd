"""Named classes of one kind: one in each module of a package, and those that plug-ins add (:mod:`.plugins`)."""

from __future__ import annotations

import importlib
import pkgutil
import re
import sys
from collections.abc import Iterable
from functools import cached_property
from types import ModuleType
from typing import Any, Generic, TypeVar

T = TypeVar("T")

registries: dict[str, Registry[Any]] = {}
"""Package -> the registry that it declared when it was imported."""


class Registry(Generic[T]):
    """Named classes of one kind, each derived from a base class that their package defines.

    Public modules of the package contain our own classes, one each.
    """

    def __init__(self, package: str) -> None:
        self.package = package
        self.added: dict[str, type[T]] = {}  # classes of plug-ins, see :mod:`.plugins`
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
        """Return the name as :meth:`load` takes it, None if there is none.

        The name is in any case, with dashes or underscores. Our own names come first, then their aliases, then the
        names of plug-ins, then their aliases: a plug-in does not change what a config means.
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
        """Return the class of a name that :meth:`find` or :meth:`names` returned."""
        if name not in self.added and name not in self._own:
            self._own[name] = self._class_in(importlib.import_module(f"{self.package}.{name}"))
        return self.added.get(name) or self._own[name]

    def _class_in(self, module: ModuleType) -> type[T]:
        own = [v for v in vars(module).values() if isinstance(v, type) and v.__module__ == module.__name__]
        found = [v for v in own if registry_of(v) is self]
        if len(found) != 1:
            names = " and ".join(v.__name__ for v in found) or "no class"
            raise TypeError(f"{module.__name__} defines {names}; a file of this folder holds one class of its family")
        return found[0]

    def add(self, kind: type[T]) -> None:
        """Add a class of a plug-in; ValueError if its name is taken."""
        name = registered_name(kind)
        if self.find(name) is not None:
            raise ValueError(f"class {kind.__name__}: there is a {name!r} in {self.package} already")
        self.added[name] = kind


def plain_name(name: str) -> str:
    """Return a name in lower case, with underscores for dashes and spaces."""
    return name.lower().replace("-", "_").replace(" ", "_")


def registry_of(kind: type) -> Registry[Any] | None:
    """Return the registry that a class belongs to, by the modules of its base classes; None if there is none."""
    for base in kind.__mro__:
        if base.__module__ in registries:
            return registries[base.__module__]
    return None


def registered_name(kind: type) -> str:
    """Return the name of a class in its registry: its module's; for a class of a plug-in its own in snake case."""
    if kind.__module__.startswith("depthcli."):
        return kind.__module__.rpartition(".")[2]
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", kind.__name__).lower()
