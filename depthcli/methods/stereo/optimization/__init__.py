"""Optimization: costs that also know about smoothness. One file a method."""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated

from depthcli.core.frames import StereoPair
from depthcli.core.method import Method, method_of
from depthcli.methods.stereo.volume import CostVolume


class Optimizer(Method):
    """Turns a cost volume into one whose cheapest cells are the answer."""

    @abstractmethod
    def __call__(self, volume: CostVolume, pair: StereoPair) -> CostVolume:
        """A volume of the same shape, to be read by winner-takes-all."""


Optimization = Annotated[Optimizer, *method_of("depthcli.methods.stereo.optimization")]
