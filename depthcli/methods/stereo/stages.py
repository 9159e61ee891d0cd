"""``PairMatcher``, the members of all matchers; ``CostStages``, the stages of methods that compute costs."""

from __future__ import annotations

from collections.abc import Iterable
from typing import ClassVar, Literal, NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.core.context import Clock, Context
from depthcli.core.frames import StereoPair
from depthcli.core.maps import DisparityMap
from depthcli.core.method import ConfigModel
from depthcli.methods.confidence import MeasureName, confidence_maps
from depthcli.methods.stereo.aggregation import Aggregation
from depthcli.methods.stereo.cost import Cost
from depthcli.methods.stereo.cost.census import Census
from depthcli.methods.stereo.optimization import Optimization, Optimizer
from depthcli.methods.stereo.optimization.scanline import Scanline
from depthcli.methods.stereo.optimization.winner_takes_all import WinnerTakesAll
from depthcli.methods.stereo.refinement import Refinement, RefinementStep
from depthcli.methods.stereo.refinement.left_right_check import LeftRightCheck
from depthcli.methods.stereo.volume import CostMinima, CostVolume, RefinementContext, StereoResult

TILE_HALO = 64
"""Pixels that a part of a pair needs around it if its method declares no other number."""


class PairMatcher(Protocol):
    """What :func:`..matching.match` needs of a matcher; ``StereoPipeline`` describes it. ``fuse`` has one, too."""

    uses_devices: ClassVar[bool]

    def __call__(self, pair: StereoPair, max_disparity: int, context: Context | None = None, /) -> StereoResult: ...

    def peak_bytes(self, shape: tuple[int, int], max_disparity: int) -> int: ...

    def tile_halo(self) -> int | None: ...

    def tile_stages(self) -> CostStages | None: ...

    def prepared(
        self, pair: StereoPair, max_disparity: int, context: Context | None, clock: Clock
    ) -> tuple[StereoPair, Self]: ...


class CostStages(ConfigModel):
    """The stages of a method that computes costs: cost measure, aggregation, optimization, refinement, confidence."""

    cost: Cost = Field(description="matching cost of two pixels")
    aggregation: Aggregation | None = Field(None, description="averaging of costs over a support window; null: none")
    optimization: Optimization = Field(
        default_factory=WinnerTakesAll,
        description="how costs are made to include smoothness; winner_takes_all: not at all",
    )
    refinement: tuple[RefinementStep, ...] = Field((), description="refinement steps on the disparity map, in order")
    confidence: tuple[MeasureName, ...] = Field(
        (), description="confidence measures whose maps are written, measured on the optimized costs"
    )

    def compute(self, pair: StereoPair, max_disparity: int, clock: Clock) -> StereoResult:
        """Match a pair by these stages over disparities 0 .. ``max_disparity`` inclusive; ``clock`` measures them."""
        volume = self.volume(pair, max_disparity, clock)
        return finish(pair, volume, self.optimization, self.refinement, self.confidence, clock).result

    def volume(self, pair: StereoPair, max_disparity: int, clock: Clock) -> CostVolume:
        """Compute costs of disparities 0 .. ``max_disparity`` before optimization; ``clock`` measures the stages."""
        clock.start("cost")
        volume = self.cost.checked_costs(pair, max_disparity + 1)
        clock.start("aggregation")
        if self.aggregation is not None:
            volume = self.aggregation(volume, pair)
        return volume

    def volume_bytes(self, shape: tuple[int, int], max_disparity: int) -> int:
        """Return the bytes of all volumes that exist at a time, and of the cost measure's temporary memory.

        The largest of: two raw volumes; raw, aggregated and sums of arms; optimized and aggregated or raw.
        """
        aggregated = self.aggregation is not None
        optimized = not isinstance(self.optimization, WinnerTakesAll)
        raw = self.cost.bytes_per_cost
        sums = 6 if aggregated else (4 if optimized else 0)
        bytes_per_cell = max(2 * raw, raw + sums)
        return shape[0] * shape[1] * ((max_disparity + 1) * bytes_per_cell + self.cost.pixel_bytes())

    def halo(self) -> int | None:
        """Return the radius, in pixels, on which optimized costs depend; None: the whole image."""
        if not isinstance(self.optimization, WinnerTakesAll):
            return None
        halos = (self.cost.halo(), 0 if self.aggregation is None else self.aggregation.halo())
        return None if halos[0] is None or halos[1] is None else halos[0] + halos[1]


def quick_stages(*further: Refinement, window: int = 7, paths: Literal[4, 8] = 8) -> CostStages:
    """Return stages for reduced pairs: census, scanlines, left-right check, and ``further`` steps of refinement.

    ``window`` is the side of the census window, pixels.
    """
    return CostStages(
        cost=Census(window=(window, window)),
        optimization=Scanline(p1=25, p2=120, paths=paths, edge_threshold=15, edge_divisor=6),
        refinement=(LeftRightCheck(), *further),
    )


class Finished(NamedTuple):
    """A result, and the winners of both views that its map was refined from."""

    result: StereoResult
    left: NDArray[np.uint16]  # (H, W)
    right: NDArray[np.uint16]


def finish(
    pair: StereoPair,
    volume: CostVolume,
    optimization: Optimizer,
    refinement: Iterable[Refinement],
    confidence: Iterable[str],
    clock: Clock,
) -> Finished:
    """Compute the map of a cost volume: optimization, winners, refinement, confidence; ``clock`` measures each."""
    clock.start("optimization")
    volume = optimization(volume, pair)
    best, right = CostMinima.of(volume)
    clock.start("refinement")
    disparity = DisparityMap(best.left.astype(np.float32), np.zeros(pair.shape, np.uint8))
    disparity = refined(disparity, refinement, RefinementContext(pair, volume, right, best))
    clock.start("confidence")
    maps = confidence_maps(volume.costs, confidence)
    return Finished(StereoResult(disparity, seconds=clock.seconds, confidence=maps), best.left, right)


def refined(disparity: DisparityMap, steps: Iterable[Refinement], context: RefinementContext) -> DisparityMap:
    """Return the map after all ``steps``, in order."""
    for step in steps:
        disparity = step(disparity, context)
    return disparity
