"""Root of the ``stereo`` command's config."""

from __future__ import annotations

from typing import Annotated, ClassVar

from pydantic import Field

from depthcli.core.root_config import RootConfig
from depthcli.stereo.pipeline import Pipeline

MaxDisparity = Annotated[
    int | None,
    Field(ge=1, le=16383, description="largest disparity searched, pixels; null: what the scene says"),
]


class StereoConfig(RootConfig):
    """A pipeline and its parameters, side by side."""

    flattened: ClassVar[str] = "pipeline"

    pipeline: Pipeline = Field(description="the data flow from image pair to map")
    max_disparity: MaxDisparity = None
