"""Combination of measures by a sum of exponentials (thesis, eq. 3.6; Mei et al. 2011)."""

from __future__ import annotations

import numpy as np
from pydantic import ConfigDict, Field

from depthcli.core import memory
from depthcli.core.frames import StereoPair
from depthcli.core.maps import Floats, Image8
from depthcli.core.method import ConfigModel
from depthcli.kernels.exponential import exp_minus_16
from depthcli.kernels.jit import helper, jit, run_bands
from depthcli.kernels.lanes import LANES, as_bytes, lane_exp_minus_16, load, load_like, splat, store
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
    """Sum over the parts of ``1 - exp(-C_m / lambda_m)``: every part is in [0, 1), so that none dominates.

    If the pair's ``light_trust`` is low, parts that compare grey levels count less, and the others more.
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
        unit, n_padded = 255 // len(self.parts), max(n_disparities, LANES)
        total: Image8 = memory.empty((*pair.shape, n_padded), np.uint8)
        weights = light_weights([part.cost for part in self.parts], pair)
        if weights is None:
            weights = np.ones((len(self.parts), pair.shape[0], 1), np.float32)
        runs = (*weights.shape[1:], -1)  # costs that share a weight: all of a pixel or of a row
        for k, (part, weight) in enumerate(zip(self.parts, weights, strict=True)):
            volume = part.cost.checked_costs(pair, n_padded)
            rate = _rate(volume.scale * part.lambda_)
            terms = volume.costs.reshape(runs), rate, np.float32(unit) * weight
            run_bands(_add_exponential, pair.shape[0], *terms, k > 0, total.reshape(runs))
        fill_outside(total, np.uint8(min(255, round(self.outside * unit))))
        return CostVolume(np.ascontiguousarray(total[:, :, :n_disparities]), float(unit))


def part_shares(lambda_: float) -> Floats:
    """Return the (256,) float32 terms in [0, 1) of all stored costs in the sum; ``lambda_`` is in stored units."""
    shares = np.empty(256, np.float32)
    _share(_rate(lambda_), shares)
    return shares


def _rate(lambda_: float) -> np.float32:
    return np.float32(1.0 / (16.0 * lambda_))


@jit
def _share(rate, shares):
    for i in range(shares.size):
        shares[i] = np.float32(1.0) - exp_minus_16(np.float32(i) * rate)


@jit
def _add_exponential(begin, end, costs, rate, units, adds, total):
    # Write ``units`` (H, R) times the terms of the costs, (H, R, N), or add them. A table of 256 terms would not
    # vectorize.
    _, n_runs, length = costs.shape
    for y in range(begin, end):
        for x in range(n_runs):
            at = (y * n_runs + x) * length
            last = at + length - LANES
            # The last vector ends at the end of the run. It overlaps the one before, so it is computed first.
            share = _with_share(costs, total, last, rate, units[y, x], adds)
            for first in range(at, last, LANES):
                store(total, first, _with_share(costs, total, first, rate, units[y, x], adds))
            store(total, last, share)


@helper
def _with_share(costs, sums, at, rate, unit, adds):
    # Lanes of the part's terms, added to ``sums`` if ``adds``, rounded half up, at most 255; see ``exp_minus_16``.
    share = splat(np.float32(1)) - lane_exp_minus_16(load(costs, at) * splat(rate))
    part = as_bytes(splat(unit) * share + splat(np.float32(0.5)))
    return load_like(part, sums, at) + part if adds else part
