"""Iterative region voting (Mei et al. 2011): empty pixels take the most frequent disparity of their support."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from depthcli.core.maps import DisparityMap
from depthcli.kernels.jit import jit, run_bands, zeros
from depthcli.methods.stereo.aggregation.cross import cross_arms
from depthcli.methods.stereo.refinement import Refinement, with_filled
from depthcli.methods.stereo.volume import RefinementContext


class RegionVoting(Refinement):
    """Give an empty pixel the most frequent disparity of its cross-shaped support if enough pixels agree."""

    needs_costs = False
    fills = True

    length: int = Field(34, ge=1, le=255, description="longest arm of the support, pixels")
    threshold: int = Field(20, ge=0, le=255, description="largest color difference within an arm, grey levels")
    inner_length: int = Field(17, ge=0, le=255, description="arm length beyond which inner_threshold applies, pixels")
    inner_threshold: int = Field(
        6, ge=0, le=255, description="largest color difference beyond inner_length, grey levels"
    )
    votes: int = Field(
        20, ge=1, le=10**6, description="number of pixels with values that a support must exceed to vote"
    )
    majority: float = Field(0.4, ge=0, le=1, description="share of votes that the chosen disparity has to exceed")
    iterations: int = Field(
        5, ge=1, le=32, description="number of rounds of voting; each uses the values filled before"
    )

    def halo(self) -> int | None:
        return self.length * self.iterations

    def __call__(self, disparity: DisparityMap, context: RefinementContext) -> DisparityMap:
        arms = cross_arms(context.pair.color8[0], self.length, self.threshold, self.inner_length, self.inner_threshold)
        values = disparity.values
        for _ in range(self.iterations):
            voted = values.copy()
            run_bands(_vote, len(values), values, arms, voted, context.volume.n_disparities, self.votes, self.majority)
            settled = np.array_equal(np.isnan(voted), np.isnan(values))
            values = voted
            if settled:
                break
        return with_filled(disparity, values)


@jit
def _vote(begin, end, values, arms, voted, bins, votes, majority):
    width = values.shape[1]
    for y in range(begin, end):
        histogram = zeros(bins, np.int32)
        for x in range(width):
            if not np.isnan(values[y, x]):
                continue
            histogram[:] = 0
            total = 0
            for v in range(y - arms[2, y, x], y + arms[3, y, x] + 1):
                row = values[v]
                for u in range(x - arms[0, v, x], x + arms[1, v, x] + 1):
                    if not np.isnan(row[u]):
                        histogram[min(bins - 1, int(row[u] + np.float32(0.5)))] += 1
                        total += 1
            if total > votes:
                winner = np.argmax(histogram)
                if histogram[winner] > majority * total:
                    voted[y, x] = winner
