"""The local pipeline (thesis chapter 3): costs, aggregation, optimization, winner-takes-all, refinement."""

from __future__ import annotations

from pydantic import Field

from depthcli.core.frames import StereoPair
from depthcli.core.result import Clock
from depthcli.methods.confidence import MeasureName
from depthcli.methods.stereo.adjustment import adjusted
from depthcli.methods.stereo.aggregation import Aggregation
from depthcli.methods.stereo.finish import finish
from depthcli.methods.stereo.optimization import Optimization
from depthcli.methods.stereo.optimization.winner_takes_all import WinnerTakesAll
from depthcli.methods.stereo.pipeline import CostPipeline
from depthcli.methods.stereo.refinement import RefinementStep
from depthcli.methods.stereo.volume import CostVolume, StereoResult


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
        pair = adjusted(pair, max_disparity, self.adjust, clock)
        volume = self.volume(pair, max_disparity, clock)
        result, _, _ = finish(pair, volume, self.optimization, self.refinement, self.confidence, clock)
        return result

    def volume(self, pair: StereoPair, max_disparity: int, clock: Clock) -> CostVolume:
        """The costs of disparities 0 .. ``max_disparity`` before optimization; ``clock`` books the stages."""
        volume = self.cost(pair, max_disparity + 1)
        clock.stop("cost")
        if self.aggregation is not None:
            volume = self.aggregation(volume, pair)
        clock.stop("aggregation")
        return volume

    def peak_bytes(self, shape: tuple[int, int], max_disparity: int) -> int:
        """Of the volumes and of the maps."""
        return self.volume_bytes(shape, max_disparity) + 200 * shape[0] * shape[1] + (64 << 20)

    def volume_bytes(self, shape: tuple[int, int], max_disparity: int) -> int:
        """By stage: two raw volumes; raw, aggregated and sums of arms; optimized beside aggregated or raw."""
        aggregated = self.aggregation is not None
        optimized = not isinstance(self.optimization, WinnerTakesAll)
        bytes_a_cell = max(2, 7 if aggregated else 0, (6 if aggregated else 5) if optimized else 0)
        return shape[0] * shape[1] * (max_disparity + 1) * bytes_a_cell
