"""Stereo pipelines: the data flow from image pair to disparity map. One file a pipeline, one page each."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from depthcli.core.method import Method, method_of
from depthcli.methods.stereo.adjustment import AdjustingMatcher
from depthcli.methods.stereo.cost import Cost
from depthcli.methods.stereo.matcher import Matcher


class StereoPipeline(Matcher, Method):
    """A complete stereo method; in a config its name stands under ``pipeline``."""


class CostPipeline(AdjustingMatcher, StereoPipeline):
    """A pipeline that begins with matching costs, of a pair whose right image is adjusted."""

    cost: Cost = Field(description="matching cost of two pixels")


Pipeline = Annotated[StereoPipeline, *method_of("depthcli.methods.stereo.pipeline", key="pipeline")]
