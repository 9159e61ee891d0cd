"""The local pipeline (thesis, chapter 3): costs, aggregation, optimization, winner-takes-all, refinement."""

from __future__ import annotations

from depthcli.core.context import Clock, Context
from depthcli.core.frames import StereoPair
from depthcli.methods.stereo.adjustment import AdjustingMatcher, adjusted
from depthcli.methods.stereo.pipeline import StereoPipeline
from depthcli.methods.stereo.stages import CostStages
from depthcli.methods.stereo.volume import StereoResult


# AdjustingMatcher is before StereoPipeline, whose ``prepared`` it replaces, and after CostStages, since pydantic lists
# the keys from the last base to the first: ``adjust`` before ``cost``.
class Local(CostStages, AdjustingMatcher, StereoPipeline):
    """Stereo by matching costs: any measure, any aggregation, any optimization, any list of refinements."""

    def __call__(self, pair: StereoPair, max_disparity: int, context: Context | None = None) -> StereoResult:
        """Match the whole pair over disparities 0 .. ``max_disparity`` inclusive."""
        clock = Clock()
        pair = adjusted(pair, max_disparity, self.adjust, context, clock)
        return self.compute(pair, max_disparity, clock)

    def peak_bytes(self, shape: tuple[int, int], max_disparity: int) -> int:
        """Estimate the bytes of the volumes and of the maps."""
        return self.volume_bytes(shape, max_disparity) + 200 * shape[0] * shape[1] + (64 << 20)

    def tile_stages(self) -> CostStages | None:
        """Return the stages; None if a refinement step needs costs, which tiles do not keep."""
        return None if any(step.needs_costs for step in self.refinement) else self
