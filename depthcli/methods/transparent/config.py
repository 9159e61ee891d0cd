"""Root of the ``transparent`` command's config."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field

from depthcli.core.bound import DepthBound
from depthcli.core.root_config import RootConfig
from depthcli.methods.transparent.cross_modal import CrossModal
from depthcli.methods.transparent.pipeline import Pipeline


class TransparentConfig(RootConfig):
    """A pipeline and its parameters, side by side."""

    command: ClassVar[str] = "transparent"

    pipeline: Pipeline = Field(description="the data flow from sensor and sparse depth to a dense map")
    stereo: CrossModal | None = Field(
        None, description="stereo of color and infrared for the sparse depth; null: a file has it"
    )
    depth_scale: float | None = Field(
        None, gt=0, le=1e6, description="codes per meter in the files; null: as the layout says"
    )
    intrinsics: tuple[float, float, float, float] | None = Field(
        None, description="fx, fy, cx, cy of the color camera, pixels; null: what the layout says"
    )
    max_bound: float | None = Field(None, ge=0, description="largest bound of points of clouds, meters; null: any")
    ply: bool = Field(False, description="write a colored point cloud of every frame, too")
    bound: DepthBound = Field(DepthBound(), description="bound of the errors and probability of a small one")
