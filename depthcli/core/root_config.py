"""The root of a command's config file."""

from __future__ import annotations

from typing import Any, ClassVar

from pydantic import BaseModel, Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from depthcli.core.method import ConfigModel, Method


class RootConfig(ConfigModel):
    """Base of a command's config, whose field named ``flattened`` holds a method written at the root of the file.

    ``{pipeline: local, cost: census, max_disparity: 60}`` reads as the field ``max_disparity`` of the command and a
    pipeline with its field ``cost``. Where the field has a default, a file that names no method has that one. A config
    whose ``flattened`` is empty has no such field. The key ``run``, which a run folder's ``run.yaml`` adds about how it
    was made, is accepted and ignored, so that this file is a config again.
    """

    command: ClassVar[str] = ""
    """The command, whose presets a config of this class may name."""
    flattened: ClassVar[str] = "pipeline"

    plugins: tuple[str, ...] = Field(
        default=(),
        description="Python files beside this file, and installed modules, with methods of your own; --plugin names a "
        "file elsewhere.",
    )
    run: dict[str, Any] | None = Field(default=None, exclude=True, description="How a run was made; ignored.")

    @model_validator(mode="before")
    @classmethod
    def _gather(cls, data: Any) -> Any:
        if not isinstance(data, dict) or not cls.flattened:
            return data
        default = cls.model_fields[cls.flattened].default
        name = data.get(cls.flattened, default.method_name() if isinstance(default, Method) else None)
        if isinstance(name, BaseModel):
            return data
        fields = cls.model_fields.keys() - {cls.flattened}
        if isinstance(data.get("run"), str | list):  # not what a run.yaml says, but the method's
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
