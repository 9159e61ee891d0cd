"""Combination of measures by a sum of exponentials (thesis, eq. 3.6; Mei et al. 2011)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field

from depthcli.core import memory
from depthcli.core.frames import StereoPair
from depthcli.core.method import ConfigModel
from depthcli.kernels.exponential import exp_minus_16
from depthcli.kernels.jit import jit, parallel_jit, prange
from depthcli.kernels.lanes import LANES, lane_exp_minus_16, load, minimum, splat, store, truncated
from depthcli.methods.stereo.cost import CostMeasure, PartCost, light_weights
from depthcli.methods.stereo.volume import CostVolume, fill_outside


class Part(ConfigModel):
    """One measure of a combination."""

    model_config = ConfigDict(populate_by_name=True)

    cost: PartCost = Field(description="cost measure of this part")
    lambda_: float = Field(
        alias="lambda", gt=0, le=1e6, description="cost at which the part's term in the sum is 1 - 1/e"
    )


class Combined(CostMeasure):
    """Sum over the parts of ``1 - exp(-C_m / lambda_m)``: every part lies in [0, 1), so that none dominates.

    Where the pair's ``light_trust`` is low, parts that compare grey levels count less, the others more.
    """

    parts: tuple[Part, ...] = Field(
        min_length=1, max_length=16, description="cost measures to combine, each with its lambda"
    )
    outside: float = Field(
        1.0, ge=0, le=16, description="cost of a match outside the right image; a part costs less than 1"
    )

    def halo(self) -> int | None:
        halos = [part.cost.halo() for part in self.parts]
        known = [halo for halo in halos if halo is not None]
        return max(known) if len(known) == len(halos) else None

    def pixel_bytes(self) -> int:
        return max(part.cost.pixel_bytes() for part in self.parts)

    def __call__(self, pair: StereoPair, n_disparities: int) -> CostVolume:
        unit = 255 // len(self.parts)
        total = memory.empty((*pair.shape, n_disparities), np.uint8)
        total[:] = 0
        weights = light_weights([part.cost for part in self.parts], pair)
        for k, part in enumerate(self.parts):
            volume = part.cost(pair, n_disparities)
            rate = _rate(volume.scale * part.lambda_)
            if weights is None:
                _add_exponential(volume.costs, rate, np.float32(unit), total)
            else:
                _add_weighted(volume.costs, rate, np.float32(unit) * weights[k], total)
        fill_outside(total, np.uint8(min(255, round(self.outside * unit))))
        return CostVolume(total, float(unit))


def part_shares(lambda_: float) -> NDArray[np.float32]:
    """Return the (256,) float32 terms in [0, 1) of all stored costs in the sum, for ``lambda_`` in stored units."""
    shares = np.empty(256, np.float32)
    _share(_rate(lambda_), shares)
    return shares


def _rate(lambda_: float) -> np.float32:
    return np.float32(1.0 / (16.0 * lambda_))


@jit
def _share(rate, shares):
    for i in range(shares.size):
        shares[i] = np.float32(1.0) - exp_minus_16(np.float32(i) * rate)


@parallel_jit
def _add_exponential(costs, rate, unit, total):
    # A table of 256 entries would not vectorize.
    height, width, n_disparities = costs.shape
    half, one = np.float32(0.5), np.float32(1.0)
    for y in prange(height):
        source = costs[y].reshape(width * n_disparities)
        out = total[y].reshape(width * n_disparities)
        for i in range(out.size):
            part = one - exp_minus_16(np.float32(source[i]) * rate)
            out[i] = np.uint8(out[i] + np.uint8(np.int32(unit * part + half)))


@parallel_jit
def _add_weighted(costs, rate, units, total):
    # As above, with a unit for every pixel.
    height, width, n_disparities = costs.shape
    half, one = np.float32(0.5), np.float32(1.0)
    for y in prange(height):
        if n_disparities < LANES:
            for x in range(width):
                source, out, unit = costs[y, x], total[y, x], units[y, x]
                for i in range(out.size):
                    part = one - exp_minus_16(np.float32(source[i]) * rate)
                    out[i] = np.uint8(min(np.int32(out[i]) + np.int32(unit * part + half), np.int32(255)))
            continue
        sources, sums = costs[y].reshape(width * n_disparities), total[y].reshape(width * n_disparities)
        for x in range(width):
            at = x * n_disparities
            end = at + n_disparities - LANES
            # The last vector ends at the last disparity. It overlaps the one before and is added to what was there.
            last = _with_share(sources, sums, end, rate, units[y, x])
            for first in range(at, end, LANES):
                store(sums, first, _with_share(sources, sums, first, rate, units[y, x]))
            store(sums, end, last)


@jit
def _with_share(costs, sums, at, rate, unit):
    # Lanes of ``sums`` with the part's terms added, rounded half up; see ``exp_minus_16``.
    share = splat(np.float32(1)) - lane_exp_minus_16(load(costs, at) * splat(rate))
    part = truncated(splat(unit) * share + splat(np.float32(0.5)))
    return minimum(load(sums, at) + part, splat(np.float32(255)))
