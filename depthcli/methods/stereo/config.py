"""The config of the ``stereo`` command, and the fields that the configs of all commands that match pairs share."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, ValidationError, field_validator, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError

from depthcli.core.bound import Bound
from depthcli.core.method import ConfigModel
from depthcli.core.root_config import RootConfig
from depthcli.methods.stereo.matching import TileMode
from depthcli.methods.stereo.pipeline import Pipeline

_MAX_DISPARITY = 16383  # pixels, 14 bits: wider than the images that any method here can match

_End = Annotated[int, Field(ge=-_MAX_DISPARITY, le=_MAX_DISPARITY)] | Literal["auto"] | None


class Calibration(ConfigModel):
    """A calibration of two cameras and how images are rectified by it; a file name may replace the whole section."""

    files: tuple[str, ...] = Field(
        min_length=1,
        max_length=2,
        description="OpenCV (YAML, XML), ROS camera_info (left, then right), Kalibr camchain or KITTI calib_cam_to_cam",
    )
    unit: Literal["m", "cm", "mm"] = Field(
        default="m", description="unit of the translation in an OpenCV calibration file"
    )
    fisheye: bool = Field(default=False, description="whether an OpenCV calibration file describes fisheye lenses")
    cameras: tuple[Annotated[int, Field(ge=0, le=9)], Annotated[int, Field(ge=0, le=9)]] = Field(
        default=(2, 3), description="numbers of the left and right camera in a KITTI calibration file"
    )
    alpha: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="extent of rectified images, from 0: only what both hold, to 1: all that either holds",
    )

    @model_validator(mode="before")
    @classmethod
    def _of_names(cls, data: Any) -> Any:
        if isinstance(data, str):
            return {"files": [data]}
        return {"files": data} if isinstance(data, list) else data


class PairConfig(RootConfig):
    """The common keys of the configs of all commands that match pairs."""

    max_disparity: _End = Field(
        None,
        description="largest disparity searched, pixels; auto: as the pair itself says; null: the scene's; where it "
        "has none, auto, and for pairs rectified by a calibration as the first frames of a sequence say",
    )
    min_disparity: _End = Field(
        None,
        description="smallest disparity searched, pixels; auto: as the pair itself says; null: the scene's, else 0",
    )
    calibration: Calibration | None = Field(
        None, description="calibration by which pairs are rectified first; null: they are rectified already"
    )
    bound: Bound | None = Field(
        None, description="bound of the errors and probability of a small one that are computed, too; true: the usual"
    )
    tiles: TileMode = Field(
        "auto",
        description="whether pairs are matched in tiles, coarse to fine where costs are not local; auto: where the "
        "whole pair would need more than tile_memory",
    )
    tile_memory: int = Field(
        3072,
        ge=300,
        le=1 << 20,
        description="memory that a pair matched in tiles may take, MiB; less where less is free",
    )

    @field_validator("bound", mode="before")
    @classmethod
    def _usual(cls, data: Any) -> Any:
        return {} if data is True else None if data is False else data

    @model_validator(mode="after")
    def _has_a_range(self) -> Self:
        smallest, largest = 0 if self.min_disparity is None else self.min_disparity, self.max_disparity
        if isinstance(largest, int) and isinstance(smallest, int) and largest <= smallest:
            problem = PydanticCustomError(
                "empty_range", "should be greater than the smallest disparity, {smallest}", {"smallest": smallest}
            )
            error: InitErrorDetails = {"type": problem, "loc": ("max_disparity",), "input": largest}
            raise ValidationError.from_exception_data(type(self).__name__, [error])
        return self


class StereoConfig(PairConfig):
    """The config of ``stereo``: a pipeline with its parameters, and the device that it runs on."""

    command: ClassVar[str] = "stereo"

    pipeline: Pipeline = Field(description="the data flow from image pair to map")
    device: str = Field(
        "cpu", description="where pairs are matched: cpu, auto (GPU if any), opencl, cuda, opencl:N or cuda:N"
    )
