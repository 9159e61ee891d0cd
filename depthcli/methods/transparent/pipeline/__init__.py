"""Pipelines that combine a sensor's depth with sparse depth to a dense map: the data flow. One file per pipeline."""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated, ClassVar, Literal

from depthcli.core.frames import SparseFrame
from depthcli.core.method import Method, method_of
from depthcli.core.result import DepthResult


class TransparentPipeline(Method):
    """Base of pipelines; a config selects a pipeline by the key ``pipeline``."""

    needs: ClassVar[Literal["sparse", "objects"]] = "sparse"
    """Input in addition to color and depth: sparse depth, or a mask of the objects."""

    bytes_per_pixel: ClassVar[int] = 160
    """Estimate of the peak working memory per pixel, bytes, without 16 MiB for the whole."""

    @abstractmethod
    def __call__(self, frame: SparseFrame) -> DepthResult:
        """Compute dense depth of ``frame``.

        Status ``KEPT`` is the sensor's value, ``CORRECTED`` replaces an unreliable value, and ``GAP_FILLED`` fills a
        gap. Either of the latter has ``SAMPLED`` too if a sample at the pixel agrees; otherwise the value is inferred
        from neighbors. A pixel that no value reaches is ``EMPTY``. The picture ``unreliable`` is 255 at unreliable
        pixels of the sensor.
        """

    def peak_bytes(self, shape: tuple[int, int]) -> int:
        """Estimate the peak working memory for a frame of ``shape``, in bytes."""
        return self.bytes_per_pixel * shape[0] * shape[1] + (16 << 20)


Pipeline = Annotated[TransparentPipeline, *method_of("depthcli.methods.transparent.pipeline", key="pipeline")]
