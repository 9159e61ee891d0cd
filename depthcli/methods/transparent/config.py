"""Root of the ``transparent`` command's config."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field

from depthcli.core.method import RootConfig
from depthcli.methods.transparent.cross_modal import CrossModal
from depthcli.methods.transparent.pipeline import Pipeline


class TransparentConfig(RootConfig):
    """A pipeline and its parameters, side by side."""

    flattened: ClassVar[str] = "pipeline"

    pipeline: Pipeline = Field(description="the data flow from sensor and sparse depth to a dense map")
    stereo: CrossModal | None = Field(
        None, description="where the sparse depth comes from: stereo of color and infrared; null: from a file"
    )
    depth_scale: float | None = Field(
        None, gt=0, le=1e6, description="codes per meter in the depth files; null: what the layout says"
    )
