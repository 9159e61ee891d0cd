"""Refinements of a sensor's depth map: the data flow from frame to refined depth. One file a pipeline."""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated, Any

from depthcli.core.frames import RgbdFrame
from depthcli.core.method import Method, method_of
from depthcli.methods.kinect.result import RefinedDepth


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


class SequencePipeline(KinectPipeline):
    """A refinement that carries what it learned from frame to frame."""

    @abstractmethod
    def step(self, frame: RgbdFrame, state: Any) -> tuple[RefinedDepth, Any]:
        """Refine the next frame.

        Parameters
        ----------
        frame : of the size of those before
        state : what the last step gave; None before the first frame
        """

    def __call__(self, frame: RgbdFrame) -> RefinedDepth:
        """Refine a frame that belongs to no sequence."""
        return self.step(frame, None)[0]


Pipeline = Annotated[KinectPipeline, *method_of("depthcli.methods.kinect.pipeline", key="pipeline")]
