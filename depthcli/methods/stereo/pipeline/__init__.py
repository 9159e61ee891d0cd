"""Stereo pipelines: the data flow from image pair to disparity map. One file a pipeline, one page each."""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated

from pydantic import Field

from depthcli.core.frames import StereoPair
from depthcli.core.method import Method, method_of
from depthcli.core.result import Clock
from depthcli.methods.stereo.cost import Cost
from depthcli.methods.stereo.matching import AdjustingMatcher, Matcher
from depthcli.methods.stereo.volume import StereoResult


class StereoPipeline(Matcher, Method):
    """A complete stereo method; in a config its name stands under ``pipeline``."""


class CostPipeline(AdjustingMatcher, StereoPipeline):
    """A pipeline that begins with matching costs."""

    cost: Cost = Field(description="matching cost of two pixels")

    def __call__(self, pair: StereoPair, max_disparity: int) -> StereoResult:
        """Match the whole pair over disparities 0 .. ``max_disparity`` inclusive."""
        clock = Clock()
        pair, _ = self.prepared(pair, max_disparity, clock)
        return self.match_prepared(pair, max_disparity, clock)

    @abstractmethod
    def match_prepared(self, pair: StereoPair, max_disparity: int, clock: Clock) -> StereoResult:
        """Match a pair whose right image is adjusted; ``clock`` books the stages."""


Pipeline = Annotated[StereoPipeline, *method_of("depthcli.methods.stereo.pipeline", key="pipeline")]
