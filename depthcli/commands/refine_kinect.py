"""Clean and complete the depth maps of a Kinect.

Examples:
  depthcli refine-kinect accurate --input frames --output runs/refined
  depthcli refine-kinect fast --color color.png --depth depth.png -o one --ply
"""

from __future__ import annotations

from typing import Annotated

from typer import Option

from depthcli.commands._options import FrameOptions, ScoredRunOptions
from depthcli.commands._shared_options import ConfigArgument, DepthScaleOption, SetOption


def refine_kinect(
    config: ConfigArgument,
    frames: FrameOptions,
    run: ScoredRunOptions,
    depth_scale: DepthScaleOption = None,
    set: SetOption = None,
    ply: Annotated[bool, Option("--ply", help="Also write a colored point cloud of every frame.")] = False,
    intrinsics: Annotated[
        str | None, Option(metavar="NUMBERS", help="Of the color camera, pixels: fx,fy,cx,cy.")
    ] = None,
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

    prepared = prepare(
        config, frames, run, set, depth_scale=depth_scale, ply=ply or None, intrinsics=intrinsics, mask=mask,
        near=near, far=far, depth_intrinsics=depth_intrinsics,
    )  # fmt: skip
    return run_batch(*prepared, run, frames)
