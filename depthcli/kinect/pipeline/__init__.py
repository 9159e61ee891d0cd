"""Refinements of a sensor's depth map: the data flow from frame to refined depth. One file a pipeline."""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated

from depthcli.core.frames import RgbdFrame
from depthcli.core.method import Method, method_of
from depthcli.kinect.result import RefinedDepth


class KinectPipeline(Method):
    """A complete refinement of one frame; in a config its name stands under ``pipeline``."""

    @abstractmethod
    def __call__(self, frame: RgbdFrame) -> RefinedDepth:
        """Refine ``frame``.

        A pixel that no model and no neighbor reaches stays NaN with status ``EMPTY``.

        Raises
        ------
        ValueError
            Where no pixel of the frame has a depth.
        """

    def peak_bytes(self, shape: tuple[int, int]) -> int:
        """Estimate of the peak working memory for a frame of ``shape``, in bytes."""
        raise NotImplementedError


Pipeline = Annotated[KinectPipeline, *method_of("depthcli.kinect.pipeline", key="pipeline")]
