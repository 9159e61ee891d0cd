"""Clean and complete the depth maps of a Kinect.

Examples:
  depthcli refine-kinect accurate --input frames --output runs/refined
  depthcli refine-kinect fast --color color.png --depth depth.png -o one --ply
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

from typer import Option

from depthcli.commands._options import (
    ConfigArgument,
    DepthOptions,
    FrameOptions,
    ScoredRunOptions,
    SetOption,
    camera_of,
)

if TYPE_CHECKING:
    from depthcli.io.scenes import RgbdScene


def refine_kinect(
    config: ConfigArgument,
    frames: FrameOptions,
    run: ScoredRunOptions,
    depths: DepthOptions,
    set: SetOption = None,
    depth_intrinsics: Annotated[
        str | None, Option(metavar="NUMS", help="Intrinsics of the depth camera, if not registered.")
    ] = None,
) -> int:
    """Refine single frames, or sequences if the method carries state from frame to frame."""
    from depthcli.commands._run import run_problem
    from depthcli.io.scenes import Folder
    from depthcli.io.scenes.frames import cameras

    camera = None if depth_intrinsics is None else camera_of("--depth-intrinsics", depth_intrinsics)

    def with_cameras(scenes: list[RgbdScene]) -> list[RgbdScene]:
        if frames.color is not None:  # meta.json next to the files may describe the cameras
            scenes = [replace(s, **cameras(Folder(s.folder, s.name, "", "").meta)) for s in scenes]
        return scenes if camera is None else [s if s.raw else replace(s, depth_intrinsics=camera) for s in scenes]

    return run_problem("refine-kinect", config, frames, run, set, with_cameras, **depths.settings())
