"""Root of the ``fuse`` command's config."""

from __future__ import annotations

from typing import Any

from pydantic import Field, model_validator

from depthcli.methods.fusion.pipeline import Fusion
from depthcli.methods.stereo.config import CalibrationFiles, MaxDisparity, MinDisparity, TileMemory, Tiles, check_range


class FuseConfig(Fusion):
    """The fields of fusion and the search range, side by side."""

    max_disparity: MaxDisparity = None
    min_disparity: MinDisparity = None
    calibration: CalibrationFiles = None
    tiles: Tiles = "auto"
    tile_memory: TileMemory = 3072
    run: dict[str, Any] | None = Field(default=None, exclude=True, description="How a run was made; ignored.")

    @model_validator(mode="after")
    def _has_a_range(self) -> FuseConfig:
        check_range(self)
        return self
