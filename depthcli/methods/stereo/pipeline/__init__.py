"""Stereo pipelines: the data flow from image pair to disparity map. One file a pipeline, one page each."""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated

from pydantic import Field

from depthcli.core.frames import StereoPair
from depthcli.core.method import Method, method_of
from depthcli.methods.stereo.adjustment import Adjust
from depthcli.methods.stereo.cost import Cost
from depthcli.methods.stereo.volume import StereoResult


class StereoPipeline(Method):
    """A complete stereo method; in a config its name stands under ``pipeline``."""

    @abstractmethod
    def __call__(self, pair: StereoPair, max_disparity: int) -> StereoResult:
        """Match ``pair`` over disparities 0 .. ``max_disparity`` inclusive."""

    def peak_bytes(self, shape: tuple[int, int], max_disparity: int) -> int:
        """Estimate of the peak working memory for images of ``shape``, in bytes."""
        raise NotImplementedError


class CostPipeline(StereoPipeline):
    """A pipeline that begins with matching costs."""

    adjust: Adjust = ()
    cost: Cost = Field(description="matching cost of two pixels")


Pipeline = Annotated[StereoPipeline, *method_of("depthcli.methods.stereo.pipeline", key="pipeline")]
