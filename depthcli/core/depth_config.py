"""What the configs of all commands that complete the depth of a sensor have in common."""

from __future__ import annotations

from pydantic import Field

from depthcli.core.bound import DepthBound
from depthcli.core.root_config import RootConfig


class DepthConfig(RootConfig):
    """How depth is read, what is said of its errors, and which points the clouds have."""

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
