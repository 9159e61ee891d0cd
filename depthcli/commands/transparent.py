"""Complete the depth of transparent objects.

Examples:
  depthcli transparent kinect --input frames --output runs/kinect
  depthcli transparent sparse --input frames --output runs/sparse --evaluate
  depthcli transparent sensor --input frames --output runs/sensor
"""

from __future__ import annotations

from typing import Annotated

from typer import Option

from depthcli.commands._options import FrameOptions, ScoredRunOptions
from depthcli.commands._shared_options import ConfigArgument, DepthScaleOption, SetOption


def transparent(
    config: ConfigArgument,
    frames: FrameOptions,
    run: ScoredRunOptions,
    depth_scale: DepthScaleOption = None,
    set: SetOption = None,
    ply: Annotated[bool, Option("--ply", help="Also write a colored point cloud of every frame.")] = False,
    intrinsics: Annotated[
        str | None, Option(metavar="NUMBERS", help="Of the color camera, pixels: fx,fy,cx,cy.")
    ] = None,
) -> int:
    """Complete every frame from its sparse depth, given or matched between color and infrared, or from a mask."""
    from depthcli.commands._batch import run_batch
    from depthcli.commands._transparent import prepare

    prepared = prepare(config, frames, run, set, intrinsics, depth_scale=depth_scale, ply=ply or None)
    return run_batch(*prepared, run, frames)
