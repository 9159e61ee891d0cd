"""Mixing of the map of the fused costs with maps of other methods."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.core.context import Clock
from depthcli.core.frames import StereoPair
from depthcli.core.maps import DisparityMap, Floats, Image8, Status
from depthcli.core.method import ConfigModel
from depthcli.kernels.jit import empty, jit, run_bands
from depthcli.kernels.winners import right_at_match
from depthcli.methods.fusion.choice import Choice, Proposals
from depthcli.methods.fusion.choice.energy import LeastEnergyChoice
from depthcli.methods.fusion.map_costs import agreement
from depthcli.methods.stereo.optimization import Optimization
from depthcli.methods.stereo.pipeline import Pipeline
from depthcli.methods.stereo.refinement import RefinementStep
from depthcli.methods.stereo.refinement.background_fill import filled_from_background
from depthcli.methods.stereo.stages import refined
from depthcli.methods.stereo.volume import CostVolume, RefinementContext

_TIMES_FILLED = np.array([bool(s & Status.FILLED) + bool(s & Status.OCCLUDED) for s in range(256)], np.uint8)
"""By status: 0 not filled, 1 filled, 2 filled and hidden from the right view."""


class MapSource(ConfigModel):
    """The source of one more map, and its weight."""

    weight: float = Field(
        1.0, ge=0, le=100, description="weight of the map in the agreement of maps; the map of the fused costs has 1"
    )


class PipelineMap(MapSource):
    """A map from a pipeline of the stereo command."""

    matcher: Pipeline = Field(description="the pipeline and its parameters, as in a config of stereo")


class OptimizedMap(MapSource):
    """A map of the fused costs, optimized in another way."""

    optimization: Optimization = Field(description="optimization of the fused costs")


class MapFusion(ConfigModel):
    """Maps of other methods to mix with the map of the fused costs, and the choice among them at a pixel.

    The proposals are, in this order, the median of the maps, the map of the fused costs (``own``), and the maps of
    ``matchers`` and of ``optimizations``.
    """

    matchers: tuple[PipelineMap, ...] = Field(
        (), max_length=16, description="pipelines of stereo, each of which makes a map"
    )
    optimizations: tuple[OptimizedMap, ...] = Field(
        (), max_length=16, description="optimizations that make further maps of the fused costs"
    )
    choice: Choice = Field(default_factory=LeastEnergyChoice, description="which map is taken where")
    refinement: tuple[RefinementStep, ...] = Field((), description="steps on the mixed map, in order")

    @property
    def kinds(self) -> tuple[str, ...]:
        """Names of the methods that make the proposals, in their order."""
        return (
            "median",
            "own",
            *(source.matcher.method_name() for source in self.matchers),
            *(source.optimization.method_name() for source in self.optimizations),
        )

    def __call__(
        self,
        pair: StereoPair,
        volume: CostVolume,
        right: NDArray[np.uint16],
        maps: list[DisparityMap],
        confidence: Collection[str],
        clock: Clock,
    ) -> tuple[DisparityMap, dict[str, Floats]]:
        """Mix ``maps`` (the own one, then the maps of ``matchers`` and of ``optimizations``) and refine the mix.

        Gaps of the maps are filled, and their median is another proposal. ``right`` (H, W) are the right view's
        disparities. Return the map and the confidences named in ``confidence``: ``agreement``, the weighted share of
        proposals that agree with the map, and, if the choice computes it, ``probability`` of the chosen map to be
        correct. Both are in [0, 1].
        """
        clock.start("proposals")
        proposals = self._proposals(pair, volume, right, maps)
        clock.start("choice")
        chosen = self.choice(proposals)
        clock.start("refinement")
        disparity = DisparityMap(chosen.values, _status(chosen.values, right))
        disparity = refined(disparity, self.refinement, RefinementContext(pair, volume, right))
        confidences = {}
        if "agreement" in confidence:
            confidences["agreement"] = agreement(disparity.values, proposals.values, proposals.weights)
        if "probability" in confidence and chosen.probability is not None:
            confidences["probability"] = chosen.probability
        return disparity, confidences

    def peak_bytes(self, shape: tuple[int, int], max_disparity: int, fused: int) -> int:
        """Estimate the peak memory of the matchers, and of mixing besides ``fused`` bytes of costs, bytes."""
        count = len(self.kinds)
        mixing = fused + shape[0] * shape[1] * (9 * count + self.choice.bytes_per_pixel(count))
        return max([mixing, *(source.matcher.peak_bytes(shape, max_disparity) for source in self.matchers)])

    def _proposals(
        self, pair: StereoPair, volume: CostVolume, right: NDArray[np.uint16], maps: list[DisparityMap]
    ) -> Proposals:
        sources = (*self.matchers, *self.optimizations)
        weights = np.array([0.0, 1.0, *(source.weight for source in sources)], np.float32)
        values = np.empty((len(weights), *pair.shape), np.float32)
        filled = np.zeros(values.shape, np.uint8)
        for k, one in enumerate(maps, start=1):
            values[k] = filled_from_background(one.values)
            filled[k] = cv2.LUT(one.status, _TIMES_FILLED)
        run_bands(_complete, values.shape[1], values, np.float32(volume.n_disparities - 1))
        return Proposals(self.kinds, values, filled, weights, pair, volume, right)


@jit
def _complete(begin, end, maps, largest):
    # The first map becomes the median of the others, whose values are limited to 0 .. ``largest``. Of an even number it
    # is the lower one in the middle: a mean would be a value that no map has.
    count, _, width = maps.shape
    for y in range(begin, end):
        ordered = empty(count, np.float32)
        for x in range(width):
            for k in range(1, count):
                value = min(maps[k, y, x], largest) if maps[k, y, x] >= 0 else np.float32(0)
                maps[k, y, x] = value
                at = k
                while at > 1 and ordered[at - 1] > value:
                    ordered[at] = ordered[at - 1]
                    at -= 1
                ordered[at] = value
            maps[0, y, x] = ordered[count // 2]


def _status(values: Floats, right: NDArray[Any]) -> Image8:
    # Measured if the right view agrees within one pixel; otherwise filled, and hidden from it or mismatched.
    match, one = right_at_match(values, right), np.float32(1)
    filled = np.where(match > values + one, Status.OCCLUDED, Status.MISMATCH) | Status.FILLED
    return np.where(np.abs(match - values) <= one, 0, filled).astype(np.uint8)
