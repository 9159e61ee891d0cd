"""Write the same disparity everywhere.

Examples:
  depthcli constant five -i scenes -o runs/five
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydantic import Field

from depthcli.commands import command
from depthcli.commands._options import ConfigArgument, PairOptions, ScoredRunOptions, SetOption
from depthcli.commands._run import find_scenes, run_job
from depthcli.core.config_file import config_with_options
from depthcli.core.context import Context
from depthcli.core.method import RootConfig
from depthcli.io.formats.disparity import write_pfm
from depthcli.io.scenes import StereoScene
from depthcli.io.scenes.pairs import PAIRS
from depthcli.io.stereo_pairs import load_pair
from depthcli.problems.problem import SceneJob, Shown
from depthcli.run.job import Outcome
from depthcli.show.table import SIZE


class ConstantConfig(RootConfig):
    """The config file of the command."""

    command = "constant"
    flattened = ""

    disparity: float = Field(5.0, ge=0, le=100, description="disparity of every pixel, pixels")


@dataclass(frozen=True)
class Constant(SceneJob[StereoScene]):
    """Computes scenes; it is sent to worker processes."""

    command = "constant"
    shown = Shown((SIZE,), protocol="middlebury-v2")

    config: ConstantConfig

    def compute(self, scene: StereoScene, folder: Path, context: Context) -> Outcome:
        """Write ``disp_left.pfm``."""
        height, width = load_pair(scene).shape
        write_pfm(folder / "disp_left.pfm", np.full((height, width), self.config.disparity, np.float32))
        return Outcome({"width": width, "height": height}, {"write": 0.0})


@command(config=ConstantConfig)
def constant(config: ConfigArgument, pairs: PairOptions, run: ScoredRunOptions, set: SetOption = None) -> int:
    """Write the same disparity everywhere.

    ``run_job`` goes through the scenes, with progress, resuming, reports and workers.
    """
    job = Constant(config_with_options(ConstantConfig, config, set, {}))
    return run_job(job, find_scenes(PAIRS, pairs, run), run, pairs)
