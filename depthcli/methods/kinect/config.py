"""Root of the ``refine-kinect`` command's config."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field

from depthcli.core.bound import DepthBound
from depthcli.core.root_config import RootConfig
from depthcli.methods.kinect.pipeline import Pipeline


class RefineKinectConfig(RootConfig):
    """A pipeline and its parameters, side by side."""

    command: ClassVar[str] = "refine-kinect"

    pipeline: Pipeline = Field(description="the data flow from frame to refined depth")
    depth_scale: float | None = Field(
        None, gt=0, le=1e6, description="codes per meter in the files; null: as the layout says"
    )
    intrinsics: tuple[float, float, float, float] | None = Field(
        None, description="fx, fy, cx, cy of the color camera, pixels; null: what the layout says"
    )
    mask: str = Field(
        "all",
        pattern=r"^(all|measured|confident:[0-9.]+(:.+)?)$",
        description="pixels of point clouds: all, measured, or confident:0.8, the surest 80 % of the measured",
    )
    near: float = Field(0.0, ge=0, description="points of clouds are no nearer, meters")
    far: float = Field(1000.0, gt=0, description="points of clouds are no farther, meters")
    max_bound: float | None = Field(None, ge=0, description="largest bound of points of clouds, meters; null: any")
    ply: bool = Field(False, description="write a colored point cloud of every frame, too")
    bound: DepthBound = Field(DepthBound(), description="bound of the errors and probability of a small one")
