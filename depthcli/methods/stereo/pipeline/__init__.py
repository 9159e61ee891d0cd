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

from typing import Annotated

from depthcli.core.method import Method, method_of
from depthcli.methods.stereo.stages import PairMatcher


class StereoPipeline(PairMatcher, Method):
    """A complete stereo method; a config names it under the key ``pipeline``."""


Pipeline = Annotated[StereoPipeline, *method_of("depthcli.methods.stereo.pipeline", key="pipeline")]
