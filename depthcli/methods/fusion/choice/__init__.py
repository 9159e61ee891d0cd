"""Choice: which of several maps is right at a pixel. One file a method."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from depthcli.core.frames import StereoPair
from depthcli.core.method import Method, method_of
from depthcli.core.networks import TrainedNetwork
from depthcli.methods.fusion.votes import ColorSupport
from depthcli.methods.stereo.volume import CostVolume

_FAR, _NEAR, _SOFTNESS = 8.0, 2.0, 15.0  # reaches of supports, pixels, and their softness, grey levels


@dataclass(frozen=True)
class Proposals:
    """N maps to choose from, and what is known about them.

    Attributes
    ----------
    kinds : what made each of them
    values : (N, H, W) float32 disparities without gaps, 0 .. D - 1
    filled : (N, H, W) uint8: 0 measured, 1 filled, 2 filled where the right view does not see
    weights : (N,) float32, what a map counts where maps agree
    pair : the images
    volume : the fused costs
    right : (H, W) uint16 disparities of the right view
    """

    kinds: tuple[str, ...]
    values: NDArray[np.float32]
    filled: NDArray[np.uint8]
    weights: NDArray[np.float32]
    pair: StereoPair
    volume: CostVolume
    right: NDArray[np.uint16]

    @cached_property
    def far(self) -> ColorSupport:
        """What evidence is averaged over where much of it is wanted."""
        return ColorSupport(self.pair.color8[0], _FAR, _SOFTNESS)

    @cached_property
    def near(self) -> ColorSupport:
        """What it is averaged over where outlines matter."""
        return ColorSupport(self.pair.color8[0], _NEAR, _SOFTNESS)


@dataclass(frozen=True)
class Chosen:
    """The map, and its probability to be right where the method knows it; (H, W) float32."""

    values: NDArray[np.float32]
    probability: NDArray[np.float32] | None = None


class Chooser(Method):
    """Makes one map of several."""

    confidences: ClassVar[tuple[str, ...]] = ()
    """Names of the confidences that it gives."""

    @property
    def network_name(self) -> str | None:
        """Name or file of the trained network that it needs; None: it needs none."""
        return None

    def with_network(self, trained: TrainedNetwork, maps: tuple[str, ...]) -> Self:
        """Return a copy that chooses by ``trained`` among ``maps``.

        Raises
        ------
        InputError
            The network was trained for other maps or other inputs.
        """
        raise NotImplementedError(f"{self.method_name()} needs no network")

    @abstractmethod
    def __call__(self, proposals: Proposals) -> Chosen:
        """At every pixel one of the proposals."""

    def bytes_a_pixel(self, count: int) -> int:
        """Working memory beside ``count`` proposals, bytes a pixel."""
        return 0


Choice = Annotated[Chooser, *method_of("depthcli.methods.fusion.choice")]
