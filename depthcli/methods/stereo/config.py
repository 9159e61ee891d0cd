"""Root of the ``stereo`` command's config."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError

from depthcli.core.root_config import RootConfig
from depthcli.methods.stereo.pipeline import Pipeline

_Pixels = Annotated[int, Field(ge=-16383, le=16383)]
MaxDisparity = Annotated[
    _Pixels | Literal["auto"] | None,
    Field(description="largest disparity searched, pixels; auto: by matched key points; null: what the scene says"),
]
MinDisparity = Annotated[
    _Pixels | Literal["auto"] | None,
    Field(description="smallest disparity searched, pixels; auto: by matched key points; null: the scene's, else 0"),
]

Tiles = Annotated[
    Literal["auto", "always", "never"],
    Field(
        description="match in tiles, coarse to fine where the method is not local; auto: where the whole pair would "
        "need more than tile_memory"
    ),
]
TileMemory = Annotated[
    int,
    Field(ge=300, le=1 << 20, description="memory that a pair matched in tiles may take; less where less is free, MiB"),
]


class Calibration(BaseModel):
    """A calibration of two cameras, and how their images are rectified by it; a file's name alone is enough."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    files: tuple[str, ...] = Field(
        min_length=1,
        max_length=2,
        description="OpenCV (YAML, XML), ROS camera_info (left, then right), Kalibr camchain or KITTI calib_cam_to_cam",
    )
    unit: Literal["m", "cm", "mm"] = Field(default="m", description="unit of OpenCV's translation")
    fisheye: bool = Field(default=False, description="the lenses of OpenCV's file are fisheye")
    cameras: tuple[Annotated[int, Field(ge=0, le=9)], Annotated[int, Field(ge=0, le=9)]] = Field(
        default=(2, 3), description="numbers of the left and right camera in KITTI's file"
    )
    alpha: float = Field(default=0.0, ge=0, le=1, description="0: only what both images hold; 1: all either holds")

    @model_validator(mode="before")
    @classmethod
    def _of_names(cls, data: Any) -> Any:
        if isinstance(data, str):
            return {"files": [data]}
        return {"files": data} if isinstance(data, list) else data


CalibrationFiles = Annotated[
    Calibration | None,
    Field(description="calibration file of cameras whose pairs are not rectified yet; null: they are"),
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
    calibration: CalibrationFiles = None
    device: str = Field("cpu", description="where to match: cpu, auto, opencl, cuda, opencl:N or cuda:N")
    tiles: Tiles = "auto"
    tile_memory: TileMemory = 3072

    @model_validator(mode="after")
    def _has_a_range(self) -> StereoConfig:
        check_range(self)
        return self
