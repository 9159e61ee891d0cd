"""Choice: which of several maps is taken at a pixel. One file per method.

Input: :class:`Proposals`, N maps (N, H, W) with the images and the fused costs. Output: a :class:`ChosenMap` (H, W).
``energy`` cuts graphs and takes any maps; ``network`` was trained for certain maps.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Annotated, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.pixel_network import TrainedNetwork
from depthcli.core.frames import StereoPair
from depthcli.core.maps import Floats, Image8
from depthcli.core.method import Method, method_of
from depthcli.methods.fusion.map_costs import Views
from depthcli.methods.stereo.volume import CostVolume


@dataclass(frozen=True)
class Proposals(Views):
    """N maps to choose from, with the data to judge them."""

    kinds: tuple[str, ...]  # names of the methods that made them
    values: Floats  # (N, H, W) float32 disparities without gaps, 0 .. D - 1
    filled: Image8  # (N, H, W) uint8: 0 measured, 1 filled, 2 filled and hidden from the right view
    weights: Floats  # (N,) float32, weight of every map in the agreement of maps
    pair: StereoPair  # the images
    volume: CostVolume  # the fused costs
    right: NDArray[np.uint16]  # (H, W) uint16 disparities of the right view


@dataclass(frozen=True)
class ChosenMap:
    """The chosen map, (H, W) float32, and its probability to be correct; None if the method does not compute it."""

    values: Floats
    probability: Floats | None = None


class ChoiceMethod(Method):
    """A way to choose one of several maps at every pixel."""

    confidences: ClassVar[tuple[str, ...]] = ()
    """Names of the confidences that it computes."""

    @property
    def network_name(self) -> str | None:
        """Name or file of the trained network that it needs; None: it needs none."""
        return None

    def with_network(self, trained: TrainedNetwork, maps: tuple[str, ...]) -> Self:
        """Return a copy that chooses by ``trained`` among ``maps``. Raise InputError for other maps or inputs."""
        raise NotImplementedError(f"{self.method_name()} needs no network")

    @abstractmethod
    def __call__(self, proposals: Proposals) -> ChosenMap:
        """Choose one of the proposals at every pixel."""

    def bytes_per_pixel(self, count: int) -> int:
        """Estimate the working memory besides ``count`` proposals, bytes per pixel."""
        return 0


Choice = Annotated[ChoiceMethod, *method_of("depthcli.methods.fusion.choice")]
