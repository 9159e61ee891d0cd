"""Write the same disparity everywhere."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from depthcli.batch.command import Outcome
from depthcli.batch.console import SIZE, Column
from depthcli.commands._batch import ConfigCommand
from depthcli.data.formats.disparity import write_pfm
from depthcli.data.scenes import Scene
from depthcli.data.scenes.stereo import StereoScene


class ConstantConfig(BaseModel):
    """The disparity."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    disparity: float = Field(5.0, ge=0, le=100, description="disparity of every pixel, pixels")
    run: dict[str, Any] | None = Field(default=None, exclude=True, description="how a run was made; ignored")


class ConstantCommand(ConfigCommand[ConstantConfig, StereoScene]):
    """Writes a map of one value for every pair."""

    kinds: ClassVar[tuple[type[Scene], ...]] = (StereoScene,)

    def config_model(self) -> type[ConstantConfig]:
        """Return the disparity's model."""
        return ConstantConfig

    def columns(self) -> tuple[Column, ...]:
        """Return the size."""
        return (SIZE,)

    def compute(self, config: ConstantConfig, scene: StereoScene, folder: Path, memory: int) -> Outcome:
        """Write ``disp_left.pfm``."""
        height, width = scene.load().shape
        write_pfm(folder / "disp_left.pfm", np.full((height, width), config.disparity, np.float32))
        return Outcome({"width": width, "height": height}, {"write": 0.0})


COMMAND = ConstantCommand()
