"""What every pipeline does with its costs: optimization, winners, refinement, confidence."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from depthcli.core.frames import StereoPair
from depthcli.core.maps import DisparityMap
from depthcli.core.result import Clock
from depthcli.kernels.winners import winners
from depthcli.methods.confidence import confidence_maps
from depthcli.methods.stereo.optimization import Optimizer
from depthcli.methods.stereo.refinement import Refinement
from depthcli.methods.stereo.volume import CostVolume, RefinementContext, StereoResult


def finish(
    pair: StereoPair,
    volume: CostVolume,
    optimization: Optimizer,
    refinement: Iterable[Refinement],
    confidence: Iterable[str],
    clock: Clock,
) -> tuple[StereoResult, NDArray[np.uint16], NDArray[np.uint16]]:
    """The result of a cost volume, and the winners of the left and the right view (H, W) uint16 it was refined from.

    Parameters
    ----------
    confidence : measures of the optimized costs
    clock : books the stages
    """
    volume = optimization(volume, pair)
    left, right = winners(volume.costs)
    clock.stop("optimization")
    disparity = DisparityMap(left.astype(np.float32), np.zeros(pair.shape, np.uint8))
    disparity = refined(disparity, refinement, RefinementContext(pair, volume, right))
    clock.stop("refinement")
    maps = confidence_maps(volume.costs, confidence)
    clock.stop("confidence")
    return StereoResult(disparity, seconds=clock.seconds, confidence=maps), left, right


def refined(disparity: DisparityMap, steps: Iterable[Refinement], evidence: RefinementContext) -> DisparityMap:
    """The map after all ``steps``, in order."""
    for step in steps:
        disparity = step(disparity, evidence)
    return disparity
