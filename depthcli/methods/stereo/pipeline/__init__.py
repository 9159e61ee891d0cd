"""The pipelines of ``stereo``: the data flow from image pair to disparity map, one file each.

| pipeline | from image pair to map |
|---|---|
| ``local`` | costs -> aggregation -> optimization -> cheapest disparities -> refinement (thesis, chapter 3) |
| ``segments`` | costs -> a plane for every segment of the left image, by graph cuts (thesis, chapter 2) |
| ``onnx`` | a network in an ONNX file -> checked against the right view's map |
| ``opencv_bm``, ``opencv_sgbm`` | OpenCV's block matching and semi-global matching, for comparison |
| ``command`` | an external program: image files -> the file of a map |
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated, ClassVar, Self

from depthcli.core.context import Clock, Context
from depthcli.core.frames import StereoPair
from depthcli.core.method import Method, method_of
from depthcli.methods.stereo.stages import TILE_HALO, CostStages
from depthcli.methods.stereo.volume import StereoResult


class StereoPipeline(Method):
    """A complete stereo method, a :class:`..stages.PairMatcher`; a config names it under the key ``pipeline``."""

    uses_devices: ClassVar[bool] = True
    """Whether :mod:`depthcli.device` opens the devices that it runs on; a network's runtime does so itself."""

    @abstractmethod
    def __call__(self, pair: StereoPair, max_disparity: int, context: Context | None = None, /) -> StereoResult:
        """Match the whole pair over disparities 0 .. ``max_disparity`` inclusive; context None: not part of a scene."""

    @abstractmethod
    def peak_bytes(self, shape: tuple[int, int], max_disparity: int) -> int:
        """Estimate the peak working memory of matching a whole pair of (H, W) ``shape``, bytes."""

    def tile_halo(self) -> int | None:
        """Return the margin, in pixels, that a part of a pair needs; None: only the whole pair can be matched."""
        return TILE_HALO

    def tile_stages(self) -> CostStages | None:
        """Return the stages if only their costs are computed tile by tile; None: each tile is matched as a pair."""
        return None

    def prepared(
        self, pair: StereoPair, max_disparity: int, context: Context | None, clock: Clock
    ) -> tuple[StereoPair, Self]:
        """Return the pair after the steps that need all of it, and a matcher without these steps for its tiles."""
        return pair, self


Pipeline = Annotated[StereoPipeline, *method_of("depthcli.methods.stereo.pipeline", key="pipeline")]
