"""The local pipeline (thesis chapter 3): costs, aggregation, optimization, winner-takes-all, refinement."""

from __future__ import annotations

import numpy as np
from pydantic import Field, field_validator

from depthcli.confidence import confidence_maps, measures
from depthcli.core.frames import StereoPair
from depthcli.core.maps import DisparityMap
from depthcli.core.result import Clock
from depthcli.kernels.winners import winners
from depthcli.stereo.aggregation import Aggregation
from depthcli.stereo.cost import Cost
from depthcli.stereo.optimization import Optimization
from depthcli.stereo.optimization.winner_takes_all import WinnerTakesAll
from depthcli.stereo.pipeline import StereoPipeline
from depthcli.stereo.refinement import RefinementStep
from depthcli.stereo.volume import Evidence, StereoResult


class Local(StereoPipeline):
    """Stereo by matching costs: any measure, any aggregation, any optimization, any list of refinements."""

    cost: Cost = Field(description="matching cost of two pixels")
    aggregation: Aggregation | None = Field(None, description="averaging over a support window; null: none")
    optimization: Optimization = Field(
        default_factory=WinnerTakesAll, description="smoothness over the image, or winner_takes_all"
    )
    refinement: tuple[RefinementStep, ...] = Field((), description="steps on the disparity map, in order")
    confidence: tuple[str, ...] = Field((), description="confidence maps to write, measured on the final volume")

    @field_validator("confidence")
    @classmethod
    def _known_measures(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        for name in names:
            if name not in measures():
                raise ValueError(f"no confidence measure called {name!r}; one of: {', '.join(measures())}")
        return names

    def __call__(self, pair: StereoPair, max_disparity: int) -> StereoResult:
        clock = Clock()
        volume = self.cost(pair, max_disparity + 1)
        clock.stop("cost")
        if self.aggregation is not None:
            volume = self.aggregation(volume, pair)
        clock.stop("aggregation")
        volume = self.optimization(volume, pair)
        left, right = winners(volume.costs)
        clock.stop("optimization")
        evidence = Evidence(pair, volume, right)
        disparity = DisparityMap(left.astype(np.float32), np.zeros(pair.shape, np.uint8))
        for step in self.refinement:
            disparity = step(disparity, evidence)
        clock.stop("refinement")
        confidence = confidence_maps(volume.costs, self.confidence) if self.confidence else {}
        clock.stop("confidence")
        return StereoResult(disparity, seconds=clock.seconds, confidence=confidence)

    def peak_bytes(self, shape: tuple[int, int], max_disparity: int) -> int:
        """By stage: two raw volumes; raw, aggregated and sums of arms; optimized beside aggregated or raw."""
        pixels = shape[0] * shape[1]
        aggregated = self.aggregation is not None
        optimized = not isinstance(self.optimization, WinnerTakesAll)
        bytes_a_cell = max(2, 7 if aggregated else 0, (6 if aggregated else 5) if optimized else 0)
        return pixels * (max_disparity + 1) * bytes_a_cell + 200 * pixels + (64 << 20)
