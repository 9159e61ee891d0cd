"""Complete the depth of transparent objects.

Examples:
  depthcli transparent kinect --input frames --output runs/kinect
  depthcli transparent sparse --input frames --output runs/sparse --evaluate
  depthcli transparent sensor --input frames --output runs/sensor
"""

from __future__ import annotations

from depthcli.commands._options import DepthOptions, FrameOptions, ScoredRunOptions
from depthcli.commands._shared_options import ConfigArgument, SetOption


def transparent(
    config: ConfigArgument,
    frames: FrameOptions,
    run: ScoredRunOptions,
    depths: DepthOptions,
    set: SetOption = None,
) -> int:
    """Complete every frame from its sparse depth, given or matched between color and infrared, or from a mask."""
    from depthcli.commands._run import run_problem

    return run_problem("transparent", config, frames, run, set, **depths.settings())
