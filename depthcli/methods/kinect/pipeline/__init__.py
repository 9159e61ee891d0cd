"""Pipelines that refine a sensor's depth map: the data flow from frame to refined depth. One file per pipeline."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from typing import Annotated, Any, ClassVar

from depthcli.core.context import Clock
from depthcli.core.frames import RgbdFrame
from depthcli.core.maps import Floats
from depthcli.core.method import Method, method_of
from depthcli.core.result import DepthResult
from depthcli.methods.kinect.disparity import measured_disparity, noise_level, refined_depth


class KinectPipeline(Method):
    """Base of pipelines that refine one frame; a config selects a pipeline by the key ``pipeline``."""

    bytes_per_pixel: ClassVar[int] = 60
    """Estimate of the peak working memory per pixel, bytes."""

    @abstractmethod
    def __call__(self, frame: RgbdFrame) -> DepthResult:
        """Refine the depth map of ``frame``; ValueError if no pixel has a depth.

        A pixel that no model and no neighbor reaches stays NaN, with status ``EMPTY``.
        """

    def peak_bytes(self, shape: tuple[int, int]) -> int:
        """Estimate the peak working memory for a frame of ``shape``, in bytes."""
        return self.bytes_per_pixel * shape[0] * shape[1]


class FilterPipeline(KinectPipeline):
    """Base of pipelines that filter the disparity."""

    @abstractmethod
    def filtered(self, frame: RgbdFrame, measured: Floats, noise: float) -> Floats:
        """Compute the refined disparity from the ``measured`` one with standard deviation ``noise``, both in pixels."""

    def __call__(self, frame: RgbdFrame) -> DepthResult:
        clock = Clock()
        clock.start("filter")
        measured = measured_disparity(frame)
        noise = noise_level(measured)
        values = self.filtered(frame, measured, noise)
        return refined_depth(frame, values, noise, clock)


class SequencePipeline(KinectPipeline):
    """Base of pipelines that carry a state from frame to frame."""

    @abstractmethod
    def step(self, frame: RgbdFrame, state: Any) -> tuple[DepthResult, Any]:
        """Refine the next frame, of the same size; ``state`` comes from the previous step, None before the first."""

    def __call__(self, frame: RgbdFrame) -> DepthResult:
        """Refine a frame that belongs to no sequence."""
        return self.step(frame, None)[0]

    @staticmethod
    def check_size(frame: RgbdFrame, previous: tuple[int, ...]) -> None:
        """Raise ValueError unless the frame has the size (H, W) of the ``previous`` ones."""
        if frame.shape != previous:
            raise ValueError(f"the frame's size {frame.shape} differs from the previous frames' {previous}")


def frame_by_frame(pipeline: KinectPipeline) -> Callable[[RgbdFrame], DepthResult]:
    """Return a function that refines the next frame of a sequence and carries a :class:`SequencePipeline`'s state."""
    if not isinstance(pipeline, SequencePipeline):
        return pipeline
    state = None

    def step(frame: RgbdFrame) -> DepthResult:
        nonlocal state
        result, state = pipeline.step(frame, state)
        return result

    return step


Pipeline = Annotated[KinectPipeline, *method_of("depthcli.methods.kinect.pipeline", key="pipeline")]
