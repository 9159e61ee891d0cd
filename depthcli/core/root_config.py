"""Base of the root config models: one algorithm whose parameters stand at the root of the file."""

from __future__ import annotations

from typing import Any, ClassVar

from pydantic import BaseModel, ConfigDict, Field, SerializerFunctionWrapHandler, model_serializer, model_validator


class RootConfig(BaseModel):
    """A config whose field named ``flattened`` holds a method written at the root.

    ``{pipeline: local, cost: census, max_disparity: 60}`` reads as the field ``max_disparity`` of the
    job and a pipeline with its field ``cost``. The key ``run`` is what a run folder's ``run.yaml`` adds
    about its making; it is accepted and ignored, so that this file is a config again.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    flattened: ClassVar[str] = "pipeline"
    renamed: ClassVar[dict[str, str]] = {}
    """Former names of fields and their names today, which the error for such an unknown key suggests."""

    run: dict[str, Any] | None = Field(default=None, exclude=True, description="How a run was made; ignored.")

    @model_validator(mode="before")
    @classmethod
    def _gather(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        own = {key: value for key, value in data.items() if key in cls.model_fields and key != cls.flattened}
        name = data.get(cls.flattened)
        if cls.flattened not in data or isinstance(name, BaseModel):
            return data if isinstance(name, BaseModel) else own
        rest = {key: value for key, value in data.items() if key not in cls.model_fields}
        return {**own, cls.flattened: {**rest, cls.flattened: name} if isinstance(name, str) else name}

    @model_serializer(mode="wrap")
    def _flatten(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        fields = handler(self)
        method = fields.pop(self.flattened)
        return {self.flattened: method.pop(self.flattened), **fields, **method}
