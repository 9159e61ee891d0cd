"""Write the same disparity everywhere."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

import numpy as np
from pydantic import Field

from depthcli.commands import ConfigCommand
from depthcli.core.method import RootConfig
from depthcli.io.formats.disparity import write_pfm
from depthcli.io.scenes import Scene
from depthcli.io.scenes.stereo import StereoScene
from depthcli.run.batch import Outcome
from depthcli.run.console import SIZE, Column


class ConstantConfig(RootConfig):
    """The config file of the command."""

    flattened = ""

    disparity: float = Field(5.0, ge=0, le=100, description="disparity of every pixel, pixels")


class ConstantCommand(ConfigCommand[ConstantConfig, StereoScene]):
    """Write the same disparity everywhere.

    ``ConfigCommand`` goes through the scenes, with progress, resuming, reports and workers.
    """

    kinds: ClassVar[tuple[type[Scene], ...]] = (StereoScene,)
    results = ("disp_left.pfm",)
    examples = ("depthcli constant five -i scenes -o runs/five",)

    def config_model(self) -> type[ConstantConfig]:
        """Return the model of the config file."""
        return ConstantConfig

    def columns(self) -> tuple[Column, ...]:
        """Return the size of the image."""
        return (SIZE,)

    def compute(self, config: ConstantConfig, scene: StereoScene, folder: Path, memory: int) -> Outcome:
        """Write ``disp_left.pfm``."""
        height, width = scene.load().shape
        write_pfm(folder / "disp_left.pfm", np.full((height, width), config.disparity, np.float32))
        return Outcome({"width": width, "height": height}, {"write": 0.0})
