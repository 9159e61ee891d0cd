"""Optimization: costs that include smoothness over the image. One file per method."""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated

from depthcli.core.frames import StereoPair
from depthcli.core.method import Method, method_of
from depthcli.methods.stereo.volume import CostVolume


class Optimizer(Method):
    """A method that adds the cost of smoothness to a cost volume."""

    @abstractmethod
    def __call__(self, volume: CostVolume, pair: StereoPair) -> CostVolume:
        """Return a volume of the same shape, from which winner-takes-all selects disparities."""


Optimization = Annotated[Optimizer, *method_of("depthcli.methods.stereo.optimization")]
