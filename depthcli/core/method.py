"""Algorithms as files: a folder of modules is a registry of methods.

A *method* is one algorithm: one module with one frozen pydantic model, whose fields are its parameters and whose
``__call__`` runs it. A *family* is the package that the modules lie in. In a config a method is written as its module's
name, ``census``, or with parameters, ``{method: census, window: [9, 7]}``. Adding a method is adding a file; nothing
else is edited. Installed packages and files of users add methods, too (see ``plugins``).
"""

from __future__ import annotations

import difflib
import importlib
import importlib.util
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any, ClassVar, Literal, LiteralString

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    SerializeAsAny,
    SerializerFunctionWrapHandler,
    ValidationInfo,
    model_serializer,
    model_validator,
)
from pydantic_core import PydanticCustomError

from depthcli.core.plugins import Plugin
from depthcli.core.registry import (
    Registry,
    plain_name,
    plugin_of,
    plugins_in_use,
    registered_name,
    registry_in,
    registry_of,
)


def _odd(side: int) -> int:
    if side % 2 == 0:
        raise ValueError("must be odd, so that it has a center")
    return side


Odd = Annotated[int, AfterValidator(_odd)]
"""Side of a window that has a center pixel."""


class Method(BaseModel):
    """Base of every algorithm; subclasses define fields and ``__call__``."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    aliases: ClassVar[tuple[str, ...]] = ()
    """Usual abbreviations of the method's name, which a config may use instead of it, in any case."""

    renamed: ClassVar[dict[str, str]] = {}
    """Former names of fields and their names today, which the error for such an unknown key suggests."""

    @classmethod
    def method_name(cls) -> str:
        """Return the name of the method in a config, that of its module."""
        return registered_name(cls)

    def used_files(self) -> dict[str, Path]:
        """Return role -> file, of files that the result depends on beside those of the scene.

        Raises
        ------
        ConfigError
            One of them is missing.
        """
        return {}

    @model_serializer(mode="wrap")
    def _with_method_name(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        family = registry_of(type(self))
        key = family.key if isinstance(family, Family) else "method"
        return {key: self.method_name(), **handler(self)}


class Family(Registry[type[Method]]):
    """The methods found in one package, and those that plug-ins add to it.

    Parameters
    ----------
    package : dotted name of the package whose public modules are the methods
    key : the config key that names the method
    """

    def __init__(self, package: str, key: str = "method") -> None:
        super().__init__(package, _method_in, self._checked)
        self.key = key

    @classmethod
    def of(cls, package: str) -> Family:
        """Return the family that ``package`` declares."""
        importlib.import_module(package)
        registry = registry_in(package)
        if not isinstance(registry, Family):
            raise KeyError(f"{package} declares no family of methods")
        return registry

    def _checked(self, value: Any) -> type[Method]:
        if not (isinstance(value, type) and issubclass(value, Method) and registry_of(value) is self):
            raise TypeError(f"want a class derived from a method of {self.package}, got {value!r}")
        return value

    def _find_alias(self, plain: str, names: Iterable[str]) -> str | None:
        return next((name for name in names if plain in map(plain_name, self.load(name).aliases)), None)

    def parse(self, value: Any, context: Any = None) -> Method:
        """Return the method that a config's ``value`` describes: a name, a mapping, or a method itself.

        Parameters
        ----------
        context : of the validation, for the validators of the method

        Raises
        ------
        PydanticCustomError, pydantic.ValidationError
            With a location below the family's field, so that errors point at the line in the file.
        """
        if isinstance(value, Method):
            return value
        if not isinstance(value, str | dict):
            raise self._error("method_type", "want a name or a mapping with '{key}'")
        fields = {self.key: value} if isinstance(value, str) else dict(value)
        name = fields.pop(self.key, None)
        if name is None:
            raise self._error("method_name", "want '{key}' in this mapping")
        own = self.find(name) if isinstance(name, str) else None
        if own is None:
            raise self._error("method_name", "no {key} called {name}", name)
        return self.load(own).model_validate(fields, context=context)

    def suggestions(self, name: object, *others: str) -> str:
        """Return the end of a message about an unknown name: the one that may be meant, and all, with their packages.

        Parameters
        ----------
        name : the unknown one; None: there was none
        others : further names that may stand there
        """
        names, plugins = [*others, *self.names()], self.plugins()
        near = difflib.get_close_matches(str(name), names, 1)
        shown = (f"{each} ({plugins[each].package})" if each in plugins else each for each in names)
        return (f"; did you mean {near[0]!r}?" if near else "") + f"; one of: {', '.join(shown)}"

    def parse_field(self, value: Any, info: ValidationInfo) -> Method:
        """Return the method that a field's ``value`` describes, as :meth:`parse`, in the context of its config."""
        return self.parse(value, info.context)

    def _error(self, kind: Literal["method_type", "method_name"], text: LiteralString, name: Any = None) -> Exception:
        values = {"key": self.key, "name": repr(name), "suggestions": self.suggestions(name)}
        return PydanticCustomError(kind, text + "{suggestions}", values)


def _method_in(module: ModuleType) -> type[Method]:
    own = [v for v in vars(module).values() if isinstance(v, type) and v.__module__ == module.__name__]
    found = [v for v in own if issubclass(v, Method) and any("__call__" in vars(base) for base in v.__mro__[:-1])]
    if len(found) != 1:
        what = " and ".join(v.__name__ for v in found) or "no method"
        raise TypeError(f"{module.__name__} defines {what}; a file of a family holds one method")
    return found[0]


def device_implementation_of(method: object) -> Any | None:
    """Return the function that does on a device what ``method`` does; None where the method has none.

    It lies in the package ``_device`` of the method's family and has the method's name.
    """
    family, _, name = type(method).__module__.rpartition(".")
    return getattr(_device_package(family), name, None) if family else None


@cache
def _device_package(family: str) -> Any | None:
    try:
        found = importlib.util.find_spec(f"{family}._device") is not None
    except ModuleNotFoundError:  # the method's module lies in no package
        found = False
    return importlib.import_module(f"{family}._device") if found else None


def method_of(package: str, key: str = "method") -> Any:
    """Return the pydantic metadata of a field that holds a method of ``package``.

    >>> class Config(BaseModel):
    ...     cost: Annotated[CostMeasure, *method_of("depthcli.methods.stereo.cost")]
    """
    return (BeforeValidator(Family(package, key).parse_field), SerializeAsAny())  # type: ignore[type-arg]  # a class at run time, an alias to mypy


class RootConfig(BaseModel):
    """Base of a command's config, whose field named ``flattened`` holds a method written at the root of the file.

    ``{pipeline: local, cost: census, max_disparity: 60}`` reads as the field ``max_disparity`` of the command and a
    pipeline with its field ``cost``. Where the field has a default, a file that names no method has that one. A config
    whose ``flattened`` is empty has no such field. The key ``run``, which a
    run folder's ``run.yaml`` adds about how it was made, is accepted and ignored, so that this file is a config again.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    flattened: ClassVar[str] = "pipeline"
    renamed: ClassVar[dict[str, str]] = {}
    """Former names of fields and their names today, which the error for such an unknown key suggests."""

    plugins: tuple[str, ...] = Field(
        default=(), description="Python files with methods of your own, beside this file; --plugin names one elsewhere."
    )
    run: dict[str, Any] | None = Field(default=None, exclude=True, description="How a run was made; ignored.")

    @model_validator(mode="before")
    @classmethod
    def _gather(cls, data: Any) -> Any:
        if not isinstance(data, dict) or not cls.flattened:
            return data
        data = cls.with_method(data)
        name = data.get(cls.flattened)
        if isinstance(name, BaseModel):
            return data
        fields = cls.model_fields.keys() - {cls.flattened}
        if isinstance(data.get("run"), str | list):  # not what a run.yaml says, but the method's
            fields -= {"run"}
        own = {key: value for key, value in data.items() if key in fields}
        if cls.flattened not in data:
            return own
        rest = {key: value for key, value in data.items() if key not in fields and key != cls.flattened}
        return {**own, cls.flattened: {**rest, cls.flattened: name} if isinstance(name, str) else name}

    @classmethod
    def with_method(cls, data: dict[str, Any]) -> dict[str, Any]:
        """Return the keys of a config, with the name of the default method where they name none and there is one."""
        default = cls.model_fields[cls.flattened].default
        return {cls.flattened: default.method_name(), **data} if isinstance(default, Method) else data

    @model_serializer(mode="wrap")
    def _flatten(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        fields: dict[str, Any] = handler(self)
        if not fields["plugins"]:
            del fields["plugins"]
        if not self.flattened:
            return fields
        method = fields.pop(self.flattened)
        return {self.flattened: method.pop(self.flattened), **fields, **method}


def used_files(value: Any) -> dict[str, Path]:
    """Return role -> file, of the files that the methods of a config use; ConfigError where one is missing."""
    found = dict(value.used_files()) if isinstance(value, Method) else {}
    if isinstance(value, BaseModel):
        inside: list[Any] = [getattr(value, name) for name in type(value).model_fields]
    else:
        inside = list(value) if isinstance(value, list | tuple) else []
    for each in inside:
        for role, file in used_files(each).items():
            found[role if found.get(role, file) == file else f"{role} {file}"] = file
    return found


def used_plugins(value: Any) -> set[Plugin]:
    """Return the plug-ins that a config, or an object, is made of.

    A word of the config counts as the name of a plug-in that is in use already (measures are written as names alone).
    """
    return set(_plugins_in(value))


def _plugins_in(value: Any) -> Iterator[Plugin]:
    if isinstance(value, str):
        if (named := plugins_in_use().get(value)) is not None:
            yield named
    elif isinstance(value, Mapping):
        yield from (plugin for each in value.values() for plugin in _plugins_in(each))
    elif isinstance(value, list | tuple):
        yield from (plugin for each in value for plugin in _plugins_in(each))
    else:
        plugin = plugin_of(type(value))
        if plugin is not None:
            yield plugin
        if isinstance(value, BaseModel):
            yield from (found for name in type(value).model_fields for found in _plugins_in(getattr(value, name)))
