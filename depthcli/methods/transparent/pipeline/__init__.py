"""Depth from a sensor and from sparse stereo: the data flow from frame to dense map. One file per pipeline."""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated, ClassVar, Literal

from depthcli.core.frames import SparseFrame
from depthcli.core.method import Method, method_of
from depthcli.core.result import DepthResult


class TransparentPipeline(Method):
    """A complete method; a config names it under the key ``pipeline``."""

    needs: ClassVar[Literal["sparse", "objects"]] = "sparse"
    """Input in addition to color and depth: the sparse depth, or the mask of the objects."""

    @abstractmethod
    def __call__(self, frame: SparseFrame) -> DepthResult:
        """Compute dense depth of ``frame``.

        Status ``KEPT`` is the sensor's value, ``CORRECTED`` replaces an unreliable one, ``GAP_FILLED`` was unknown to
        the sensor; either with ``SAMPLED`` where a sample at the pixel agrees, else it is inferred from around. A pixel
        that no value reaches is ``EMPTY``. The picture ``unreliable`` is 255 where the sensor is unreliable.
        """

    @abstractmethod
    def peak_bytes(self, shape: tuple[int, int]) -> int:
        """Estimate of the peak working memory for a frame of ``shape``, in bytes."""


Pipeline = Annotated[TransparentPipeline, *method_of("depthcli.methods.transparent.pipeline", key="pipeline")]
