"""Root of the ``transparent`` command's config."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field

from depthcli.core.depth_config import DepthConfig
from depthcli.methods.transparent.cross_modal import CrossModal
from depthcli.methods.transparent.pipeline import Pipeline


class TransparentConfig(DepthConfig):
    """A pipeline and its parameters, side by side."""

    command: ClassVar[str] = "transparent"

    pipeline: Pipeline = Field(description="the data flow from sensor and sparse depth to a dense map")
    stereo: CrossModal | None = Field(
        None, description="stereo of color and infrared for the sparse depth; null: a file has it"
    )
