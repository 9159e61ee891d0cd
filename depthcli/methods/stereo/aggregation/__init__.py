"""Aggregation: averaging costs over a support window. One file a method."""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated

from depthcli.core.frames import StereoPair
from depthcli.core.method import Method, method_of
from depthcli.methods.stereo.volume import CostVolume


class Aggregator(Method):
    """Averages the costs of a support window, disparity by disparity."""

    @abstractmethod
    def __call__(self, volume: CostVolume, pair: StereoPair) -> CostVolume:
        """A new volume of the same shape; the input is not modified."""

    def halo(self) -> int | None:
        """Pixels around a pixel that its means depend on; None: the whole image."""
        return None


Aggregation = Annotated[Aggregator, *method_of("depthcli.methods.stereo.aggregation")]
