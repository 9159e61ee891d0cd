"""The local pipeline (thesis chapter 3): costs, aggregation, optimization, winner-takes-all, refinement."""

from __future__ import annotations

from depthcli.core.frames import StereoPair
from depthcli.core.result import Clock
from depthcli.methods.stereo.pipeline import CostPipeline
from depthcli.methods.stereo.stages import CostStages, finish
from depthcli.methods.stereo.volume import StereoResult


class Local(CostStages, CostPipeline):
    """Stereo by matching costs: any measure, any aggregation, any optimization, any list of refinements."""

    def match_prepared(self, pair: StereoPair, max_disparity: int, clock: Clock) -> StereoResult:
        """Match by the stages, in order."""
        volume = self.volume(pair, max_disparity, clock)
        result, _, _ = finish(pair, volume, self.optimization, self.refinement, self.confidence, clock)
        return result

    def peak_bytes(self, shape: tuple[int, int], max_disparity: int) -> int:
        """Estimate the bytes of the volumes and of the maps."""
        return self.volume_bytes(shape, max_disparity) + 200 * shape[0] * shape[1] + (64 << 20)

    def cost_stages(self) -> CostStages | None:
        """Return the pipeline itself, but where a refinement step looks at costs: it needs the whole volume."""
        return None if any(step.needs_costs for step in self.refinement) else self
