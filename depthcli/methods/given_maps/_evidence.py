"""What the images say, before any map is looked at: matching costs, and the disparities that they prefer."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from depthcli.core.frames import StereoPair
from depthcli.core.maps import DisparityMap
from depthcli.core.result import Clock
from depthcli.kernels.winners import winners
from depthcli.methods.fusion.votes import PairSupports
from depthcli.methods.stereo.adjustment import adjusted
from depthcli.methods.stereo.cost.census import Census
from depthcli.methods.stereo.optimization.scanline import Scanline
from depthcli.methods.stereo.refinement.background_fill import BackgroundFill
from depthcli.methods.stereo.refinement.left_right_check import LeftRightCheck
from depthcli.methods.stereo.refinement.median import Median
from depthcli.methods.stereo.refinement.speckle_filter import SpeckleFilter
from depthcli.methods.stereo.refinement.subpixel import Subpixel
from depthcli.methods.stereo.refinement.surface_fill import SurfaceFill
from depthcli.methods.stereo.stages import refined
from depthcli.methods.stereo.volume import CostVolume, RefinementContext

# Those of the preset stereo fast; networks are trained with them.
_COST = Census(window=(7, 7))
_OPTIMIZATION = Scanline(p1=25, p2=120, paths=8, edge_threshold=15, edge_divisor=6)
_REFINEMENT = (
    LeftRightCheck(),
    SpeckleFilter(size=50),
    Subpixel(),
    SurfaceFill(rows=4, reach=20),
    BackgroundFill(),
    Median(window=5),
)

BYTES_PER_CELL = 7
"""Of the costs: raw ones, two sums of paths, optimized ones."""
BYTES_PER_PIXEL = 400


@dataclass(frozen=True)
class Evidence(PairSupports):
    """Costs of a pair, by which its maps are judged."""

    pair: StereoPair  # the images, the right one in the light of the left one
    volume: CostVolume  # (H, W, D) matching costs
    optimized: CostVolume  # (H, W, D) the costs with smoothness
    # left, right: (H, W) uint16, disparities of the smallest optimized costs of either view
    left: NDArray[np.uint16]
    right: NDArray[np.uint16]
    reference: DisparityMap  # the map of the preset stereo fast, made of these costs

    @classmethod
    def of(cls, pair: StereoPair, max_disparity: int, clock: Clock) -> Evidence:
        """Compute the costs of disparities 0 .. ``max_disparity``; ``clock`` books the stages."""
        pair = adjusted(pair, max_disparity, ("noise", "rows", "light"), clock)
        clock.start("cost")
        volume = _COST(pair, max_disparity + 1)
        clock.start("optimization")
        optimized = _OPTIMIZATION(volume, pair)
        left, right = winners(optimized.costs)
        clock.start("refinement")
        raw = DisparityMap(left.astype(np.float32), np.zeros(pair.shape, np.uint8))
        reference = refined(raw, _REFINEMENT, RefinementContext(pair, optimized, right))
        return cls(pair, volume, optimized, left, right, reference)

    @cached_property
    def grey(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Both images, grey levels 0 .. 255 as float32."""
        left, right = (image.astype(np.float32) for image in self.pair.grey8)
        return left, right
