"""The measures that are fused: cost measures of stereo, and cost volumes made elsewhere."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from depthcli.core.errors import InputError
from depthcli.core.frames import StereoPair
from depthcli.methods.stereo.cost import PartCost
from depthcli.methods.stereo.volume import CostVolume


class FusedMeasure(BaseModel):
    """One of the measures to fuse: a cost measure, or a cost volume read from a file."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    flattened: ClassVar[str] = "cost"  # a measure may be written as its cost alone

    cost: PartCost | None = Field(None, description="a cost measure of the stereo command")
    volume: str | None = Field(
        None,
        description="instead of cost: .npy file of (H, W, D) costs, lower is better, relative to the left image's "
        "folder; {scene} stands for the scene's name",
    )
    scale: float | None = Field(
        None,
        gt=0,
        le=1e9,
        description="cost that counts as 1 - 1/e, in units of the measure; null: the pair's median cost",
    )

    @model_validator(mode="before")
    @classmethod
    def _name_alone(cls, value: Any) -> Any:
        if isinstance(value, str) or (isinstance(value, dict) and "method" in value):
            return {"cost": value}
        return value

    @model_validator(mode="after")
    def _one_source(self) -> FusedMeasure:
        if (self.cost is None) == (self.volume is None):
            raise ValueError("want either cost or volume")
        return self

    def costs(self, pair: StereoPair, n_disparities: int, volumes: Mapping[str, NDArray[Any]]) -> CostVolume:
        """Return the costs of ``n_disparities`` disparities; InputError where the volume is missing or unusable."""
        if self.cost is not None:
            return self.cost(pair, n_disparities)
        assert self.volume is not None
        if self.volume not in volumes:
            raise InputError(f"{self.volume}: no such volume")
        costs = volumes[self.volume]
        if costs.ndim != 3 or costs.shape[:2] != pair.shape or costs.shape[2] < n_disparities:
            height, width = pair.shape
            raise InputError(
                f"{self.volume}: want shape ({height}, {width}, {n_disparities} or more), got {costs.shape}"
            )
        if costs.dtype not in (np.uint8, np.uint16):
            if costs.dtype.kind not in "fiub":
                raise InputError(f"{self.volume}: want numbers, got {costs.dtype}")
            with np.errstate(over="ignore"):
                costs = costs.astype(np.float32)
            if not np.isfinite(costs[:, :, :n_disparities]).all():
                raise InputError(f"{self.volume}: holds NaN or infinite costs")
        return CostVolume(np.ascontiguousarray(costs[:, :, :n_disparities]))
