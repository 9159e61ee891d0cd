"""Clean and complete the depth maps of a Kinect.

Examples:
  depthcli refine-kinect accurate --input frames --output runs/refined
  depthcli refine-kinect fast --color color.png --depth depth.png -o one --ply
"""

from __future__ import annotations

from typing import Annotated

from typer import Option

from depthcli.commands._options import DepthOptions, FrameOptions, ScoredRunOptions
from depthcli.commands._shared_options import ConfigArgument, SetOption


def refine_kinect(
    config: ConfigArgument,
    frames: FrameOptions,
    run: ScoredRunOptions,
    depths: DepthOptions,
    set: SetOption = None,
    depth_intrinsics: Annotated[
        str | None, Option(metavar="NUMS", help="Of the depth camera, if not registered.")
    ] = None,
) -> int:
    """Refine single frames, or sequences where the method carries state from frame to frame."""
    from depthcli.commands._batch import run_batch
    from depthcli.commands._refine_kinect import prepare

    return run_batch(*prepare(config, frames, run, set, depths, depth_intrinsics), run, frames)
