"""Algorithms as files: a folder of modules is a registry of methods.

A *method* is one algorithm: one module with one frozen pydantic model, whose fields are its parameters and whose
``__call__`` runs it. A *family* is the package with the modules. In a config a method is written as its module's
name, ``census``, or with parameters, ``{method: census, window: [9, 7]}``. A new file is a new method; plug-ins add
methods, too (see ``plugins``).
"""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, cast, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ModelWrapValidatorHandler,
    SerializeAsAny,
    SerializerFunctionWrapHandler,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_serializer,
    model_validator,
)
from pydantic_core import InitErrorDetails, PydanticCustomError

from depthcli.core.plugins import Plugin, Registry, plugins_of, registered_name, registries, registry_of
from depthcli.core.text import did_you_mean


def _odd(side: int) -> int:
    if side % 2 == 0:
        raise ValueError("must be odd, so that it has a center")
    return side


Odd = Annotated[int, AfterValidator(_odd)]
"""Side of a window that has a center pixel."""


def _takes(annotation: Any, kinds: tuple[type, ...]) -> bool:
    """Return whether an annotation, or a part of it, is one of these types."""
    return annotation in kinds or any(_takes(part, kinds) for part in get_args(annotation))


class ConfigModel(BaseModel):
    """Base of all parts of a config. An unknown key is an error that suggests a similar one."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    renamed: ClassVar[dict[str, str]] = {}
    """Former name of a field -> its name, which the error for the former name suggests."""

    @field_validator("*", mode="before")
    @classmethod
    def _no_truth_values_for_numbers(cls, value: Any, info: ValidationInfo) -> Any:
        parts = value if isinstance(value, list | tuple) else [value]
        if info.field_name is not None and bool in map(type, parts):
            annotation = cls.model_fields[info.field_name].annotation
            if _takes(annotation, (int, float)) and not _takes(annotation, (bool,)):
                raise PydanticCustomError("number", "should be a number, and is true or false")
        return value

    @model_validator(mode="wrap")
    @classmethod
    def _say_which_keys_there_are(cls, data: Any, handler: ModelWrapValidatorHandler[Any]) -> Any:
        try:
            return handler(data)
        except ValidationError as error:
            details = [cls._with_hint(each) for each in error.errors(include_url=False)]
            raise ValidationError.from_exception_data(error.title, details) from None

    @classmethod
    def _with_hint(cls, error: Any) -> InitErrorDetails:
        kind, text, place, facts = error["type"], error["msg"], error["loc"], error.get("ctx", {})
        method = getattr(cls, "flattened", "")
        if method and place[:1] == (method,) and len(place) > 1:  # its keys are at the root of the file
            place = place[1:]
        if len(place) == 1 and kind in ("extra_forbidden", "unknown_key"):
            own = [info.alias or name for name, info in cls.model_fields.items() if not info.exclude]
            known = [*dict.fromkeys([*facts.get("known", ()), *own])]
            renamed = facts.get("renamed", {}) | cls.renamed
            hint = did_you_mean(str(place[0]), known, renamed) or f"; there are: {', '.join(known)}" * bool(known)
            kind, text, facts = "unknown_key", f"no such key{hint}", {"known": known, "renamed": renamed}
        custom = PydanticCustomError(kind, "{text}", {**facts, "text": text})
        return InitErrorDetails(type=custom, loc=place, input=error["input"])


class Method(ConfigModel):
    """Base of every algorithm; subclasses define fields and ``__call__``."""

    aliases: ClassVar[tuple[str, ...]] = ()
    """Abbreviations of the method's name that a config may use, in any case."""

    @classmethod
    def method_name(cls) -> str:
        """Return the name of the method in a config, which is its module's name."""
        return registered_name(cls)

    def used_files(self) -> dict[str, Path]:
        """Return role -> file for every dependency besides the scene's files. Raise ConfigError if one is missing."""
        return {}

    @model_serializer(mode="wrap")
    def _with_method_name(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        family = registry_of(type(self))
        key = family.key if isinstance(family, Family) else "method"
        return {key: registered_name(type(self)), **handler(self)}


class RootConfig(ConfigModel):
    """Base of a command's config. The keys of the method in its field ``flattened`` are at the root of the file.

    ``{pipeline: local, cost: census, max_disparity: 60}`` reads as the field ``max_disparity`` of the command and a
    pipeline with its field ``cost``. If the field has a default, it is used for a file that names no method. A config
    whose ``flattened`` is empty has no such field. The key ``run`` of a run folder's ``run.yaml`` is ignored, so that
    this file is a config, too.
    """

    command: ClassVar[str] = ""
    """The command, whose presets a config of this class may name."""
    flattened: ClassVar[str] = "pipeline"

    plugins: tuple[str, ...] = Field(
        default=(),
        description="Python files next to this file, and installed modules, with methods of your own; --plugin names a "
        "file elsewhere.",
    )
    run: dict[str, Any] | None = Field(default=None, exclude=True, description="How a run was made; ignored.")

    @model_validator(mode="before")
    @classmethod
    def _gather(cls, data: Any) -> Any:
        if not isinstance(data, dict) or not cls.flattened:
            return data
        default = cls.model_fields[cls.flattened].default
        name = data.get(cls.flattened, registered_name(type(default)) if isinstance(default, Method) else None)
        if isinstance(name, BaseModel):
            return data
        fields = cls.model_fields.keys() - {cls.flattened}
        if isinstance(data.get("run"), str | list):  # the method's key, not that of a run.yaml
            fields -= {"run"}
        own: dict[str, Any] = {}
        rest: dict[str, Any] = {}
        for key, value in data.items():
            (own if key in fields else rest)[key] = value
        rest.pop(cls.flattened, None)
        if name is None and cls.flattened not in data:
            return own
        return {**own, cls.flattened: {**rest, cls.flattened: name} if isinstance(name, str) else name}

    @model_serializer(mode="wrap")
    def _flatten(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        fields: dict[str, Any] = handler(self)
        if not fields["plugins"]:
            del fields["plugins"]
        if not self.flattened:
            return fields
        method = fields.pop(self.flattened)
        return {self.flattened: method.pop(self.flattened), **fields, **method}


class Family(Registry[Method]):
    """The methods in the public modules of one package, and of plug-ins; ``key`` names one in configs."""

    def __init__(self, package: str, key: str = "method") -> None:
        super().__init__(package)
        self.key = key

    @classmethod
    def of(cls, package: str) -> Family:
        """Return the family that ``package`` declares. Raise TypeError if it declares none."""
        importlib.import_module(package)
        family = registries.get(package)
        if not isinstance(family, cls):
            raise TypeError(f"{package} declares no family of methods")
        return family

    def parse(self, value: Any, info: ValidationInfo | None) -> Method:
        """Return the method that a config's ``value`` describes: a name, a mapping, or a method itself.

        Errors of pydantic have a location below the family's field, so that they point at the line in the file.
        """
        if isinstance(value, Method):
            return value
        if not isinstance(value, str | dict):
            raise self._unknown(f"expected a name or a mapping with {self.key!r}")
        fields = {self.key: value} if isinstance(value, str) else dict(value)
        name = fields.pop(self.key, None)
        known = self.find(name) if isinstance(name, str) else None
        if known is None:
            missing = f"expected {self.key!r} in this mapping"
            raise self._unknown(missing if name is None else f"no {self.key} called {name!r}", name)
        return self.load(known).model_validate(fields, context=info and info.context)

    def suggestions(self, name: object, *others: str) -> str:
        """Return the end of a message about an unknown name: a similar name, and all names, with ``others``."""
        names, shown = [*others, *self.names()], [*others, *self.own_names]
        shown += [
            f"{each} ({plugin.package})" for each in sorted(self.added) for plugin in plugins_of([self.added[each]])
        ]
        return f"{did_you_mean(str(name), names)}; one of: {', '.join(shown)}"

    def _unknown(self, text: str, name: Any = None) -> PydanticCustomError:
        return PydanticCustomError("method_name", "{text}", {"text": text + self.suggestions(name)})


def method_of(package: str, key: str = "method") -> Any:
    """Return the pydantic metadata of a field for a method of ``package``.

    >>> class Config(BaseModel):
    ...     cost: Annotated[CostMeasure, *method_of("depthcli.methods.stereo.cost")]
    """
    return (BeforeValidator(Family(package, key).parse), cast(Any, SerializeAsAny)())


def used_files(value: Any) -> dict[str, Path]:
    """Return role -> file for all files of a config's methods. Raise ConfigError if one is missing."""
    files: dict[str, Path] = {}
    for part in parts_of(value):
        for role, file in part.used_files().items() if isinstance(part, Method) else ():
            files[role if files.get(role, file) == file else f"{role} {file}"] = file
    return files


def used_plugins(value: Any) -> set[Plugin]:
    """Return the plug-ins of the objects in a config, and of its words, since measures are written as names alone."""
    added = {name: kind for registry in registries.values() for name, kind in registry.added.items()}
    return plugins_of(added.get(each, str) if isinstance(each, str) else type(each) for each in parts_of(value))


def parts_of(value: Any) -> Iterator[Any]:
    """Yield a value and everything in it: values of fields, of mappings and of lists."""
    yield value
    if isinstance(value, BaseModel):
        for name in type(value).model_fields:
            yield from parts_of(getattr(value, name))
    elif isinstance(value, Mapping | list | tuple):
        for part in value.values() if isinstance(value, Mapping) else value:
            yield from parts_of(part)
