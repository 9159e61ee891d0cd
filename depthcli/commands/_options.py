"""Groups of options of the commands that run over scenes: which scenes, how they are computed, what is kept."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, ClassVar

import typer
from typer import Argument, Option

from depthcli.commands._shared_options import (
    FailFlaggedOption,
    FlagOption,
    HtmlOption,
    InputOption,
    LayoutOption,
    MaxDisparityOption,
    Printing,
    ScenesOption,
    parse_bytes,
)
from depthcli.core.errors import ConfigError
from depthcli.run.batch import Execution, shard_of
from depthcli.run.flags import Condition, conditions_of

_URL = re.compile(r"[a-z][a-z0-9+.-]+:/", re.IGNORECASE)  # pathlib leaves one slash


@dataclass(frozen=True, kw_only=True)
class SceneOptions:
    """Which scenes a command works on; a group of a command adds the options that name the files of a single one."""

    single_files: ClassVar[str] = ""
    """The options that name the files of a single scene, for messages."""

    input: InputOption = None
    name: Annotated[str | None, Option(metavar="NAME", help="Name of a single scene. Default: from its file.")] = None
    layout: LayoutOption = None
    scenes: ScenesOption = None

    @property
    def patterns(self) -> list[str]:
        """The shell patterns of ``--scenes``, or the one that every name matches."""
        return self.scenes or ["*"]


@dataclass(frozen=True, kw_only=True)
class PairOptions(SceneOptions):
    """Image pairs: a folder of them, or the files of one, or of several by patterns or videos."""

    single_files: ClassVar[str] = "--left FILE and --right FILE"

    left: Annotated[
        Path | None, Option(metavar="FILE", help="Left image, pattern, folder or video; replaces --input.")
    ] = None
    right: Annotated[Path | None, Option(metavar="FILE", help="Right image, likewise.")] = None


@dataclass(frozen=True, kw_only=True)
class RangeOptions(PairOptions):
    """Image pairs with what else is known of them: calibration and search range, which override keys of the config."""

    calibration: Annotated[
        Path | None, Option(metavar="FILE", help="Calibration, for pairs that are not rectified.")
    ] = None
    unit: Annotated[
        str | None, Option(metavar="UNIT", help="Unit of an OpenCV calibration's translation: m, cm or mm.")
    ] = None
    max_disparity: MaxDisparityOption = None
    min_disparity: Annotated[
        str | None, Option(metavar="N", help="Smallest disparity searched, or auto. Default: 0.")
    ] = None


@dataclass(frozen=True, kw_only=True)
class CodingOptions:
    """How the maps of other runs are named and coded."""

    pattern: Annotated[
        list[str] | None, Option(metavar="PATTERN", help="Path of a map, '{scene}/a.tiff'. Of one run: NAME=...")
    ] = None
    scale: Annotated[
        list[str] | None, Option(metavar="CODES", help="Codes per pixel of integer maps. Of one run: NAME=...")
    ] = None
    invalid: Annotated[
        list[str] | None, Option(metavar="VALUE", help="Value of maps that means none, or nan. Of one run: NAME=...")
    ] = None


@dataclass(frozen=True, kw_only=True)
class FrameOptions(SceneOptions):
    """Frames of color and depth: a folder of them, or the files of one."""

    single_files: ClassVar[str] = "--color FILE and --depth FILE"

    color: Annotated[Path | None, Option(metavar="FILE", help="Color image, instead of --input.")] = None
    depth: Annotated[Path | None, Option(metavar="FILE", help="Depth map, registered to --color if given.")] = None


def _local(output: Path | None) -> Path | None:
    if output is not None and _URL.match(str(output)) and not os.path.lexists(output.parts[0]):
        raise typer.BadParameter("results are written to this machine, not to URLs; give a folder")
    return output


@dataclass(frozen=True, kw_only=True)
class RunOptions(Printing):
    """How the scenes are computed, where the results go, and what is reported of them.

    ``evaluate`` and ``html`` become options of commands whose group declares them so, see :class:`ScoredRunOptions`.
    """

    output: Annotated[Path, Option("--output", "-o", metavar="DIR", help="Folder to write into.", callback=_local)]
    overwrite: Annotated[bool, Option("--overwrite", help="Replace an earlier run that had another config.")] = False
    keep: Annotated[
        str | None, Option(metavar="NAMES", help="Files kept, as disp_left.pfm,status.png. Default: all.")
    ] = None
    jobs: Annotated[
        int, Option("--jobs", "-j", metavar="N", min=1, max=512, help="Scenes at a time, each in a process.")
    ] = 1
    threads: Annotated[
        int | None, Option(metavar="N", min=1, max=1024, help="Threads of a process. Default: cores / --jobs.")
    ] = None
    max_memory: Annotated[
        str | None, Option(metavar="SIZE", help="Memory to use, such as 2GiB. Default: all free.")
    ] = None
    shard: Annotated[str | None, Option(metavar="I/N", help="Compute part I of N. Default: from Slurm.")] = None
    scheduler: Annotated[
        str | None, Option(metavar="ADDRESS", help="tcp://HOST:PORT of a dask.distributed cluster.")
    ] = None
    fail_fast: Annotated[bool, Option("--fail-fast", help="Stop at the first scene that fails.")] = False
    list_scenes: Annotated[bool, Option("--list-scenes", help="Print the names of the scenes; compute nothing.")] = (
        False
    )
    dry_run: Annotated[bool, Option("--dry-run", help="Print config, scenes and memory; compute nothing.")] = False
    flag: FlagOption = None
    fail_flagged: FailFlaggedOption = False
    evaluate: bool = False
    html: bool = False

    def __post_init__(self) -> None:
        """Raise ConfigError where options are wrong or exclude each other, before any file is read."""
        if self.execution.shard is not None and (self.evaluate or self.html):
            raise ConfigError("--evaluate needs all scenes: run depthcli evaluate when all shards are done")
        if self.scheduler is not None and self.jobs != 1:
            raise ConfigError("--jobs and --scheduler exclude each other: a cluster has as many workers as it has")
        assert isinstance(self.conditions, list)

    @cached_property
    def conditions(self) -> list[Condition]:
        """The conditions of ``--flag``; ConfigError if one is wrong, or ``--fail-flagged`` has none."""
        return conditions_of(self.flag, self.fail_flagged)

    @cached_property
    def execution(self) -> Execution:
        """How the run is carried out; ConfigError for a wrong size or shard."""
        return Execution(
            jobs=self.jobs,
            threads=self.threads,
            max_memory=parse_bytes(self.max_memory) if self.max_memory else None,
            overwrite=self.overwrite,
            shard=shard_of(self.shard, os.environ),
            fail_fast=self.fail_fast,
            keep=tuple(name.strip() for name in (self.keep or "").split(",") if name.strip()),
            scheduler=self.scheduler,
        )


@dataclass(frozen=True, kw_only=True)
class ScoredRunOptions(RunOptions):
    """The options of a run whose results can be compared with ground truth of its input."""

    evaluate: Annotated[bool, Option("--evaluate", help="Compare the results with the input's ground truth.")] = False
    html: HtmlOption = False


@dataclass(frozen=True, kw_only=True)
class BoardOptions:
    """The board, as it is printed."""

    board: Annotated[str, Option(metavar="BOARD", help="COLUMNSxROWS: inner corners; charuco:COLUMNSxROWS: squares.")]
    square: Annotated[str, Option(metavar="LENGTH", help="Edge of a square, with its unit (mm, cm, m).")]
    marker: Annotated[str | None, Option(metavar="LENGTH", help="Edge of a marker of a ChArUco board.")] = None
    dictionary: Annotated[str, Option(metavar="NAME", help="Markers of a ChArUco board.")] = "4X4_50"


@dataclass(frozen=True, kw_only=True)
class RectifyOptions:
    """By what pairs are rectified."""

    calibration: Annotated[
        list[Path] | None,
        Option(
            metavar="FILE",
            help="Calibration: OpenCV (YAML, XML), ROS camera_info (left, then right), Kalibr camchain or KITTI "
            "calib_cam_to_cam; repeatable.",
        ),
    ] = None
    uncalibrated: Annotated[
        bool, Option("--uncalibrated", help="Rectify by matched key points alone; depths stay unknown.")
    ] = False
    unit: Annotated[
        str, Option(metavar="UNIT", help="Unit of the translation in an OpenCV calibration: m, cm or mm.")
    ] = "m"
    fisheye: Annotated[bool, Option("--fisheye", help="The lenses of an OpenCV file are fisheye.")] = False
    cameras: Annotated[str, Option(metavar="L,R", help="Numbers of the left and right camera in a KITTI file.")] = "2,3"
    alpha: Annotated[
        float,
        Option(metavar="SHARE", min=0, max=1, help="0: keep only what both images show; 1: keep all of both."),
    ] = 0.0


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
