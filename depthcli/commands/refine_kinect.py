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
    mask: Annotated[str | None, Option(metavar="WHICH", help="Pixels of clouds: all, measured, confident:0.8.")] = None,
    near: Annotated[float | None, Option(metavar="METERS", help="Nearest depth of point clouds.")] = None,
    far: Annotated[float | None, Option(metavar="METERS", help="Farthest depth of point clouds.")] = None,
) -> int:
    """Refine single frames, or sequences where the method carries state from frame to frame."""
    from depthcli.commands._batch import run_batch
    from depthcli.commands._refine_kinect import prepare

    prepared = prepare(config, frames, run, set, depths, depth_intrinsics, mask=mask, near=near, far=far)
    return run_batch(*prepared, run, frames)
