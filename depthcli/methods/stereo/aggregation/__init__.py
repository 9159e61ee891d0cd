"""Aggregation: means of a cost volume over support windows. One file per method."""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated

from depthcli.core.frames import StereoPair
from depthcli.core.method import Method, method_of
from depthcli.methods.stereo.volume import CostVolume


class Aggregator(Method):
    """A mean of costs over a support window, disparity by disparity."""

    @abstractmethod
    def __call__(self, volume: CostVolume, pair: StereoPair) -> CostVolume:
        """Return a new volume of the same shape; the input is not modified."""

    def halo(self) -> int | None:
        """Return the radius in pixels of the window that a pixel's means depend on; None: the whole image."""
        return None


Aggregation = Annotated[Aggregator, *method_of("depthcli.methods.stereo.aggregation")]
