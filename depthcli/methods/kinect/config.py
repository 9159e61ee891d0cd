"""Root of the ``refine-kinect`` command's config."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field

from depthcli.core.depth_config import DepthConfig
from depthcli.methods.kinect.bounds import BYTES_PER_PIXEL
from depthcli.methods.kinect.pipeline import Pipeline


class RefineKinectConfig(DepthConfig):
    """A pipeline and its parameters, side by side."""

    command: ClassVar[str] = "refine-kinect"

    pipeline: Pipeline = Field(description="the data flow from frame to refined depth")

    def peak_bytes(self, shape: tuple[int, int]) -> int:
        """Estimate of the peak working memory for a frame of ``shape``, in bytes."""
        return max(self.pipeline.peak_bytes(shape), BYTES_PER_PIXEL * shape[0] * shape[1])
