"""The interface of everything that matches a pair: the pipelines of ``stereo``, and fusion."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

from depthcli.core.frames import StereoPair
from depthcli.core.result import Clock
from depthcli.methods.stereo.stages import CostStages
from depthcli.methods.stereo.volume import StereoResult


class Matcher(ABC):
    """Anything that matches a pair, and declares what :mod:`depthcli.methods.stereo.matching` decides by."""

    has_tiles: ClassVar[bool] = True
    """Whether parts of a pair can be matched by themselves."""

    @abstractmethod
    def __call__(self, pair: StereoPair, max_disparity: int, /) -> StereoResult:
        """Match the whole pair over disparities 0 .. ``max_disparity`` inclusive."""

    @abstractmethod
    def peak_bytes(self, shape: tuple[int, int], max_disparity: int) -> int:
        """Estimate the peak working memory of matching a whole pair of (H, W) ``shape``, bytes."""

    def device_bytes(self, shape: tuple[int, int], max_disparity: int) -> int | None:
        """Estimate the memory of a device that matches a whole pair, bytes; None: only the processor can."""
        return None

    def cost_stages(self) -> CostStages | None:
        """Return the stages whose costs can be computed tile by tile; None: tiles are matched as pairs of their own."""
        return None

    def prepared(self, pair: StereoPair, max_disparity: int, clock: Clock) -> tuple[StereoPair, Matcher]:
        """Apply the steps that need the whole images; return the new pair, and the matcher without these steps.

        For pairs that are matched in tiles or on a device; ``__call__`` includes these steps.
        """
        return pair, self
