"""The local pipeline (thesis chapter 3): costs, aggregation, optimization, winner-takes-all, refinement."""

from __future__ import annotations

from pydantic import Field

from depthcli.confidence import MeasureName
from depthcli.core.frames import StereoPair
from depthcli.core.result import Clock
from depthcli.stereo.aggregation import Aggregation
from depthcli.stereo.finish import finish
from depthcli.stereo.optimization import Optimization
from depthcli.stereo.optimization.winner_takes_all import WinnerTakesAll
from depthcli.stereo.pipeline import CostPipeline
from depthcli.stereo.refinement import RefinementStep
from depthcli.stereo.volume import StereoResult


class Local(CostPipeline):
    """Stereo by matching costs: any measure, any aggregation, any optimization, any list of refinements."""

    aggregation: Aggregation | None = Field(None, description="averaging over a support window; null: none")
    optimization: Optimization = Field(
        default_factory=WinnerTakesAll, description="smoothness over the image, or winner_takes_all"
    )
    refinement: tuple[RefinementStep, ...] = Field((), description="steps on the disparity map, in order")
    confidence: tuple[MeasureName, ...] = Field(
        (), description="confidence maps to write, measured on the final volume"
    )

    def __call__(self, pair: StereoPair, max_disparity: int) -> StereoResult:
        clock = Clock()
        volume = self.cost(pair, max_disparity + 1)
        clock.stop("cost")
        if self.aggregation is not None:
            volume = self.aggregation(volume, pair)
        clock.stop("aggregation")
        result, _, _ = finish(pair, volume, self.optimization, self.refinement, self.confidence, clock)
        return result

    def peak_bytes(self, shape: tuple[int, int], max_disparity: int) -> int:
        """By stage: two raw volumes; raw, aggregated and sums of arms; optimized beside aggregated or raw."""
        pixels = shape[0] * shape[1]
        aggregated = self.aggregation is not None
        optimized = not isinstance(self.optimization, WinnerTakesAll)
        bytes_a_cell = max(2, 7 if aggregated else 0, (6 if aggregated else 5) if optimized else 0)
        return pixels * (max_disparity + 1) * bytes_a_cell + 200 * pixels + (64 << 20)
