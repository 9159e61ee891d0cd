"""Combination of measures by a sum of exponentials (eq. 3.6; Mei et al. 2011)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from depthcli.core import memory
from depthcli.core.frames import StereoPair
from depthcli.kernels.exponential import exp_minus_16
from depthcli.kernels.jit import parallel_jit, prange
from depthcli.stereo.cost import CostMeasure, PartCost
from depthcli.stereo.outside import fill_outside
from depthcli.stereo.volume import CostVolume


class Part(BaseModel):
    """One measure of the combination."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, populate_by_name=True)

    cost: PartCost = Field(description="the measure")
    lambda_: float = Field(alias="lambda", gt=0, le=1e6, description="cost at which the part has risen to 1 - 1/e")


class Combined(CostMeasure):
    """Sum over the parts of ``1 - exp(-C_m / lambda_m)``: every part lies in [0, 1), none can dominate."""

    parts: tuple[Part, ...] = Field(min_length=1, max_length=16, description="measures and their lambdas")
    outside: float = Field(
        1.0, ge=0, le=16, description="cost of a match outside the right image, in units of one part"
    )

    def halo(self) -> int | None:
        halos = [part.cost.halo() for part in self.parts]
        known = [halo for halo in halos if halo is not None]
        return max(known) if len(known) == len(halos) else None

    def __call__(self, pair: StereoPair, disparities: int) -> CostVolume:
        unit = 255 // len(self.parts)
        total = memory.empty((*pair.shape, disparities), np.uint8)
        total[:] = 0
        for part in self.parts:
            volume = part.cost(pair, disparities)
            _add_exponential(volume.costs, _rate(volume.scale * part.lambda_), np.float32(unit), total)
        fill_outside(total, np.uint8(min(255, round(self.outside * unit))))
        return CostVolume(total, float(unit))


def part_table(lambda_: float, unit: int) -> NDArray[np.uint8]:
    """(256,): what each stored cost adds to the sum, ``lambda_`` in stored units."""
    table = np.zeros((1, 1, 256), np.uint8)
    _add_exponential(np.arange(256, dtype=np.uint8)[None, None], _rate(lambda_), np.float32(unit), table)
    return table.reshape(256)


def _rate(lambda_: float) -> np.float32:
    return np.float32(1.0 / (16.0 * lambda_))


@parallel_jit
def _add_exponential(costs: Any, rate: Any, unit: Any, total: Any) -> None:
    # A table of 256 entries would not vectorize.
    height, width, depth = costs.shape
    half, one = np.float32(0.5), np.float32(1.0)
    for y in prange(height):
        source = costs[y].reshape(width * depth)
        out = total[y].reshape(width * depth)
        for i in range(out.size):
            part = one - exp_minus_16(np.float32(source[i]) * rate)
            out[i] = np.uint8(out[i] + np.uint8(np.int32(unit * part + half)))
