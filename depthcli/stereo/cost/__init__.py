"""Cost measures: how unlike two pixels are. One file a measure."""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated

from depthcli.core.frames import StereoPair
from depthcli.core.method import Method, method_of
from depthcli.stereo.volume import CostVolume


class CostMeasure(Method):
    """A similarity measure of two pixels, turned into costs."""

    @abstractmethod
    def __call__(self, pair: StereoPair, disparities: int) -> CostVolume:
        """Cost volume of disparities 0 .. ``disparities`` - 1."""


Cost = Annotated[CostMeasure, *method_of("depthcli.stereo.cost")]
