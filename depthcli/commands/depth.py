"""Turn disparity maps into metric depth and point clouds.

The calibration lies beside the images that the run was made from (``calib.txt`` of Middlebury, ETH3D and of
``rectify``, KITTI's files), or is given by options.

Examples:
  depthcli depth runs/accurate --output depth --ply --far 10
  depthcli depth disp_left.pfm --focal 700 --baseline 0.12 --output depth
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from depthcli.commands._options import HtmlOption, InputOption, LayoutOption, RunOptions, ScenesOption


@dataclass(frozen=True, kw_only=True)
class DepthRunOptions(RunOptions):
    """The options of a run that has no ground truth, with a page."""

    html: HtmlOption = False


@dataclass(frozen=True, kw_only=True)
class MapOptions:
    """The maps of a run, or a single one, and their calibration."""

    run: Annotated[Path, Argument(metavar="RUN", help="Run folder of stereo or fuse, or one disparity map.")]
    input: InputOption = None
    layout: LayoutOption = None
    scenes: ScenesOption = None
    left: Annotated[Path | None, Option(metavar="FILE", help="Left image of a single map, for the point cloud.")] = None
    calibration: Annotated[
        Path | None, Option(metavar="FILE", help="Calibration of all scenes: calib.txt, or KITTI's.")
    ] = None
    focal: Annotated[
        float | None, Option(metavar="PIXELS", min=1e-6, help="Focal length, if there is no calibration.")
    ] = None
    baseline: Annotated[
        float | None, Option(metavar="METERS", min=1e-9, help="Distance of the cameras, with --focal.")
    ] = None
    doffs: Annotated[
        float | None, Option(metavar="PIXELS", help="x of the right principal point minus the left one's.")
    ] = None


@dataclass(frozen=True, kw_only=True)
class CloudOptions:
    """Which pixels get a depth, and which are points of a cloud."""

    mask: Annotated[
        str | None,
        Option(
            metavar="WHICH",
            help="Pixels that get a depth: all, measured, or confident:0.8, the 80 % of the measured ones with the "
            "highest confidence (confident:0.8:NAME of several). Default: all, in clouds measured.",
        ),
    ] = None
    ply: Annotated[bool, Option("--ply", help="Also write a colored point cloud of every scene.")] = False
    near: Annotated[float, Option(metavar="METERS", min=0, help="Nearest depth of point clouds.")] = 0.0
    far: Annotated[float | None, Option(metavar="METERS", min=0, help="Farthest depth of point clouds.")] = None
    depth_scale: Annotated[float, Option(metavar="CODES", min=1e-3, max=1e6, help="Codes per meter in depth.png.")] = (
        1000.0
    )


def depth(maps: MapOptions, clouds: CloudOptions, run: DepthRunOptions) -> int:
    """Turn every map of the run into depth; return the exit code."""
    from depthcli.commands._depth import depth_of_maps

    return depth_of_maps(maps, clouds, run)
