"""Complete the depth of transparent objects.

Examples:
  depthcli transparent kinect --input frames --output runs/kinect
  depthcli transparent sparse --input frames --output runs/sparse --evaluate
  depthcli transparent sensor --input frames --output runs/sensor
  depthcli transparent sensor --color c.png --depth d.png --objects m.png -o o
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Option

from depthcli.commands._options import ConfigArgument, DepthOptions, FrameOptions, ScoredRunOptions, SetOption
from depthcli.core.errors import ConfigError

if TYPE_CHECKING:
    from depthcli.io.scenes import RgbdScene


def transparent(
    config: ConfigArgument,
    frames: FrameOptions,
    run: ScoredRunOptions,
    depths: DepthOptions,
    set: SetOption = None,
    objects: Annotated[
        Path | None, Option(metavar="FILE", help="Mask of the transparent objects, for presets such as sensor.")
    ] = None,
) -> int:
    """Complete every frame from sparse depth, from stereo of color and infrared, or from a mask."""
    from depthcli.commands._run import job_and_scenes, run_job
    from depthcli.io.rgbd_frames import TRANSPARENT
    from depthcli.io.scenes.places import local
    from depthcli.problems.transparent import Transparent

    def with_objects(scenes: list[RgbdScene]) -> list[RgbdScene]:
        return [replace(scene, masks={**scene.masks, TRANSPARENT: mask}) for scene in scenes] if mask else scenes

    mask = None if objects is None else local(objects)
    if mask is not None and frames.color is None:
        raise ConfigError(
            "--objects belongs to --color and --depth; in a folder the mask is mask_transparent.* of a scene"
        )
    job, scenes = job_and_scenes("transparent", config, frames, run, set, with_objects, **depths.settings())
    if mask is not None and not (isinstance(job, Transparent) and job.by_mask):
        raise ConfigError(f"--objects: {config} does not look at a mask of the objects; presets such as sensor do")
    return run_job(job, scenes, run, frames)
