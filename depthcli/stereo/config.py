"""Root of the ``stereo`` command's config."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, ValidationError, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError

from depthcli.core.root_config import RootConfig
from depthcli.stereo.pipeline import Pipeline

_Pixels = Annotated[int, Field(ge=-16383, le=16383)]
MaxDisparity = Annotated[
    _Pixels | Literal["auto"] | None,
    Field(description="largest disparity searched, pixels; auto: by matched key points; null: what the scene says"),
]
MinDisparity = Annotated[
    _Pixels | Literal["auto"] | None,
    Field(description="smallest disparity searched, pixels; auto: by matched key points; null: the scene's, else 0"),
]


def check_range(config: Any) -> None:
    """Raise ValidationError where the config's range is empty."""
    low, top = config.min_disparity, config.max_disparity
    least = 0 if low is None else low
    if isinstance(top, int) and isinstance(least, int) and top <= least:
        problem = PydanticCustomError(
            "empty_range", "should be greater than the smallest disparity, {low}", {"low": least}
        )
        error: InitErrorDetails = {"type": problem, "loc": ("max_disparity",), "input": top}
        raise ValidationError.from_exception_data(type(config).__name__, [error])


class StereoConfig(RootConfig):
    """A pipeline and its parameters, side by side."""

    flattened: ClassVar[str] = "pipeline"

    pipeline: Pipeline = Field(description="the data flow from image pair to map")
    max_disparity: MaxDisparity = None
    min_disparity: MinDisparity = None
    device: str = Field("cpu", description="where to match: cpu, auto, opencl, cuda, opencl:N or cuda:N")

    @model_validator(mode="after")
    def _has_a_range(self) -> StereoConfig:
        check_range(self)
        return self
