"""Options, alone and in groups, as typer reads them from the types of parameters.

A command has single options (``set: SetOption = None``) and groups (``run: RunOptions``): dataclasses whose fields
become options.
"""

from __future__ import annotations

import json
import math
import os
import re
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, TypeAlias

from typer import Argument, BadParameter, Option

from depthcli.core.errors import ConfigError
from depthcli.run.console import Reporter
from depthcli.run.flags import Condition, conditions_of
from depthcli.run.job import Execution, shard_of

if TYPE_CHECKING:
    from depthcli.evaluation.protocols import Settings

NOWHERE = Path(os.devnull, "no output")
"""Stands for the run folder if none is given, which is allowed if nothing is computed."""
_MAX_JOBS = 512
_URL = re.compile(r"[a-z][a-z0-9+.-]+:/", re.IGNORECASE)  # pathlib merges the two slashes
_UNITS = {"": 1, "k": 10**3, "m": 10**6, "g": 10**9, "t": 10**12, "ki": 2**10, "mi": 2**20, "gi": 2**30, "ti": 2**40}


# Names are given if typer would derive others from the parameter; flags then get no "--no-...".
ConfigArgument: TypeAlias = Annotated[
    str,
    Argument(metavar="CONFIG", help="YAML file, or the name of a preset."),
]
InputOption: TypeAlias = Annotated[
    Path | None,
    Option("--input", "-i", metavar="DIR", help="Folder, archive or URL; or CSV of stereo pairs (-: stdin)."),
]
LayoutOption: TypeAlias = Annotated[
    str | None,
    Option(metavar="NAME", help="Layout of the folder. Default: recognized."),
]
ScenesOption: TypeAlias = Annotated[
    list[str] | None, Option(metavar="GLOB", help="Only scenes whose name matches; repeatable.")
]
SetOption: TypeAlias = Annotated[
    list[str] | None,
    Option(metavar="KEY=VALUE", help="Override one key of the config; repeatable."),
]
MaxDisparityOption: TypeAlias = Annotated[
    str | None, Option(metavar="N", help="Largest disparity searched, or auto: from the pair.")
]
WithinOption: TypeAlias = Annotated[
    float, Option(metavar="PX", min=0.25, max=8, help="Error up to which a value is right in probability.pfm, pixels.")
]
LevelOption: TypeAlias = Annotated[
    float, Option(metavar="P", min=0.5, max=0.99, help="Share of the errors that are not larger than bound.pfm.")
]
HtmlBudgetOption: TypeAlias = Annotated[
    str, Option(metavar="SIZE", help="Size of its pictures beyond which they are scaled down.")
]
HtmlOption: TypeAlias = Annotated[bool, Option("--html", help="Also write evaluation/report.html.")]
FlagOption: TypeAlias = Annotated[
    list[str] | None, Option(metavar="CONDITION", help="Flag rows, such as 'measured<0.6'; repeatable, any of them.")
]
FailFlaggedOption: TypeAlias = Annotated[bool, Option("--fail-flagged", help="Exit with 4 where a row is flagged.")]


def option(default: Any, *names: str, **settings: Any) -> Any:
    """Return a field of a group that is an option, with the arguments of ``typer.Option``."""
    return field(default=default, metadata={"option": Option(*names, **settings)})


@dataclass(frozen=True, kw_only=True)
class Printing:
    """Options of the output on the terminal."""

    json: bool = option(False, "--json", help="Print one JSON document instead of a table.")
    verbose: bool = option(False, "--verbose", "-v", help="Print details on stderr.")
    quiet: bool = option(False, "--quiet", "-q", help="Print only errors, and no table.")
    command_line: str = ""  # this call, quoted for a shell

    @cached_property
    def reporter(self) -> Reporter:
        """The reporter for messages and data."""
        return Reporter(-1 if self.quiet else int(self.verbose), self.command_line)


@dataclass(frozen=True, kw_only=True)
class TableOptions:
    """Selection and format of printed tables of an evaluation."""

    tables: str | None = option(
        None, metavar="NAMES", help="Tables to print: all, or metrics,scenes-nonocc ... or headline."
    )
    format: str | None = option(None, metavar="FORMAT", help="Print wide tables: latex, markdown or csv.")
    columns: str | None = option(None, metavar="NAMES", help="Print only these columns of the tables.")
    caption: str | None = option(None, metavar="TEXT", help="Caption, if --tables chooses a single table.")


def local_output(output: Path | None) -> Path | None:
    """Return the value of ``--output``. Raise typer.BadParameter if it is no place on this machine."""
    if output is not None and _URL.match(str(output)) and not os.path.lexists(output.parts[0]):
        raise BadParameter("results are written to this machine, not to URLs; give a folder")
    if str(output) == "-":
        raise BadParameter("results are files, nothing that can be written to stdout; see --json")
    return output


def parse_bytes(text: str, option: str = "--max-memory") -> int:
    """Return a size such as ``2GiB``, ``500M`` or ``1e9`` in bytes. Raise ConfigError for other texts."""
    match = re.fullmatch(r"\s*(\d{1,18}(?:\.\d{0,9})?(?:[eE]\d{1,2})?)\s*([kmgt]i?|)b?\s*", text, re.IGNORECASE)
    size = int(float(match[1]) * _UNITS[match[2].lower()]) if match else 0
    if size < 1:
        raise ConfigError(f"{option}: must be a size such as 2GiB or 500M (got {text[:40]!r})")
    return size


def parse_disparity(text: str | None) -> int | None:
    """Return the largest disparity of ``--max-disparity``, or None. Raise ConfigError if it is no valid number."""
    from depthcli.methods.stereo.search_range import MAX_DISPARITY

    if text is None:
        return None
    if not text.isdigit() or not 1 <= int(text) <= MAX_DISPARITY:
        raise ConfigError(f"--max-disparity: expected a whole number from 1 to {MAX_DISPARITY} (got {text!r})")
    return int(text)


@dataclass(frozen=True, kw_only=True)
class SceneOptions:
    """Options that select scenes; subclasses add options for the files of a single scene."""

    single_files: ClassVar[str] = ""
    """The options that name the files of a single scene, for messages."""

    input: InputOption = None
    name: str | None = option(None, metavar="NAME", help="Name of a single scene. Default: from its file.")
    layout: LayoutOption = None
    scenes: ScenesOption = None


@dataclass(frozen=True, kw_only=True)
class PairOptions(SceneOptions):
    """Image pairs: a folder of pairs, or left and right as files, patterns or videos."""

    single_files: ClassVar[str] = "--left FILE and --right FILE"

    left: Path | None = option(None, metavar="FILE", help="Left image, pattern, folder or video; replaces --input.")
    right: Path | None = option(None, metavar="FILE", help="Right image, pattern, folder or video.")
    halves: str | None = option(None, metavar="HOW", help="--left contains both views: left-right or top-bottom.")


@dataclass(frozen=True, kw_only=True)
class CalibrationOptions:
    """A calibration of two cameras and options for reading it."""

    calibration: list[Path] | None = option(
        None,
        metavar="FILE",
        help="Calibration: OpenCV (YAML, XML), ROS camera_info (left, then right), Kalibr camchain, KITTI "
        "calib_cam_to_cam or ZED conf; repeatable.",
    )
    unit: str | None = option(
        None,
        metavar="UNIT",
        help="Unit of its lengths: m, cm, mm, or a length such as 24mm. Default: that of the format, usually m.",
    )
    fisheye: bool = option(False, "--fisheye", help="The lenses of an OpenCV file are fisheye.")
    cameras: str | None = option(
        None, metavar="L,R", help="Numbers of the left and right camera in a KITTI file. Default: 2,3."
    )
    alpha: float | None = option(
        None, metavar="SHARE", min=0, max=1, help="0: keep only pixels with image content; 1: keep all. Default: 0."
    )

    def settings(self) -> dict[str, Any]:
        """Return config key -> YAML text, None if not given."""
        return {
            "calibration": json.dumps(list(map(str, self.calibration))) if self.calibration else None,
            "calibration.fisheye": self.fisheye or None,
            "calibration.alpha": self.alpha,
            "calibration.unit": self.unit and json.dumps(self.unit),
            "calibration.cameras": self.cameras and f"[{self.cameras}]",
        }


@dataclass(frozen=True, kw_only=True)
class RangeOptions(CalibrationOptions, PairOptions):
    """Image pairs with calibration and search range, which override keys of the config."""

    max_disparity: MaxDisparityOption = None
    min_disparity: str | None = option(None, metavar="N", help="Smallest disparity searched, or auto. Default: 0.")

    def settings(self) -> dict[str, Any]:
        """Return config key -> YAML text, None if not given."""
        return super().settings() | {"max_disparity": self.max_disparity, "min_disparity": self.min_disparity}


@dataclass(frozen=True, kw_only=True)
class BoundOptions:
    """Error bounds of maps, and requirements on them."""

    bound: bool = option(
        False, "--bound", help="Also write bound.pfm, which 90 % of the errors do not exceed, and probability.pfm."
    )
    level: LevelOption = 0.9
    within: WithinOption = 1.0

    def promise(self) -> dict[str, float] | None:
        """Return the requirements, or None without ``--bound``."""
        return {"level": self.level, "within": self.within} if self.bound else None


@dataclass(frozen=True, kw_only=True)
class CodingOptions:
    """Naming and coding of maps from other programs."""

    pattern: list[str] | None = option(
        None, metavar="PATTERN", help="Path of a map, '{scene}/a.tiff'. For one run: NAME=..."
    )
    scale: list[str] | None = option(
        None, metavar="CODES", help="Codes per unit of integer maps. For one run: NAME=..."
    )
    invalid: list[str] | None = option(
        None, metavar="VALUE", help="Number that means no value, or nan. For one run: NAME=..."
    )


@dataclass(frozen=True, kw_only=True)
class FrameOptions(SceneOptions):
    """RGB-D frames: a folder of frames, or the files of one frame."""

    single_files: ClassVar[str] = "--color FILE and --depth FILE"

    color: Path | None = option(None, metavar="FILE", help="Color image, instead of --input.")
    depth: Path | None = option(None, metavar="FILE", help="Depth map; if --color is given, registered to it.")


@dataclass(frozen=True, kw_only=True)
class DepthOptions:
    """Options for reading the depth of sensors, and for output besides the refined map."""

    depth_scale: float | None = option(None, metavar="CODES", help="Codes per meter in the depth files.")
    intrinsics: str | None = option(
        None, metavar="NUMBERS", help="Intrinsics of the color camera, pixels: fx,fy,cx,cy."
    )
    ply: bool = option(False, "--ply", help="Also write a colored point cloud of every frame.")
    mask: str | None = option(None, metavar="WHICH", help="Pixels of clouds: measured, all, confident:0.8.")
    near: float | None = option(None, metavar="METERS", help="Nearest depth of point clouds.")
    far: float | None = option(None, metavar="METERS", help="Farthest depth of point clouds.")
    max_bound: float | None = option(None, metavar="METERS", min=0, help="Largest bound of the error in point clouds.")
    level: float | None = option(
        None,
        metavar="P",
        min=0.5,
        max=0.99,
        help="Share of the errors within bound.pfm. Default: 0.9.",
    )
    within: float | None = option(
        None, metavar="METERS", help="Error up to which a value is correct in probability.pfm. Default: 0.03."
    )

    def settings(self) -> dict[str, Any]:
        """Return config key -> value, None if not given. Raise ConfigError for impossible intrinsics."""
        given = vars(self) | {"ply": self.ply or None}
        if self.intrinsics is not None:
            camera_of("--intrinsics", self.intrinsics)
            given["intrinsics"] = f"[{self.intrinsics}]"
        return given | {"bound.level": given.pop("level"), "bound.within": given.pop("within")}


def camera_of(option: str, text: str) -> tuple[float, float, float, float]:
    """Return fx, fy, cx, cy from an option. Raise ConfigError if they are impossible."""
    try:
        fx, fy, cx, cy = (float(number) for number in text.split(","))
    except ValueError:
        fx = fy = cx = cy = math.nan
    if not (all(map(math.isfinite, (fx, fy, cx, cy))) and min(fx, fy) > 0):
        raise ConfigError(f"{option}: expected fx,fy,cx,cy in pixels, focal lengths above 0 (got {text[:64]!r})")
    return fx, fy, cx, cy


@dataclass(frozen=True, kw_only=True)
class RunOptions(Printing):
    """Options for computation, output and reports."""

    output: Annotated[
        Path,
        Option(
            "--output", "-o", metavar="DIR", show_default=False, callback=local_output,
            help="Folder to write into; required but for a dry run.",
        ),
    ] = NOWHERE  # fmt: skip
    overwrite: bool = option(False, "--overwrite", help="Replace an earlier run that had another config.")
    keep: str | None = option(None, metavar="NAMES", help="Files to keep, disp_left.pfm,status.png. Default: all.")
    jobs: str = option(
        "auto", "--jobs", "-j", metavar="N", help="Scenes at a time, each in a process; auto: the fastest number."
    )
    threads: int | None = option(
        None, metavar="N", min=1, max=1024, help="Threads per process. Default: cores / --jobs."
    )
    max_memory: str | None = option(None, metavar="SIZE", help="Memory to use, such as 2GiB. Default: all free.")
    shard: str | None = option(None, metavar="I/N", help="Compute part I of N. Default: from Slurm.")
    scheduler: str | None = option(None, metavar="ADDRESS", help="tcp://HOST:PORT of a dask.distributed cluster.")
    fail_fast: bool = option(False, "--fail-fast", help="Stop at the first scene that fails.")
    list_scenes: bool = option(False, "--list-scenes", hidden=True)  # for scripts: --dry-run --quiet
    dry_run: bool = option(False, "--dry-run", help="Print the names of the scenes and, on stderr, the plan.")
    flag: FlagOption = None
    fail_flagged: FailFlaggedOption = False

    def __post_init__(self) -> None:
        """Raise ConfigError for invalid or contradictory options, before any file is read."""
        if self.output == NOWHERE and not (self.dry_run or self.list_scenes):
            raise ConfigError("give --output DIR, the folder to write into")
        if self.scheduler is not None and self.jobs not in ("auto", "1"):
            raise ConfigError("--jobs and --scheduler exclude each other: a cluster has as many workers as it has")
        _ = self.execution, self.conditions  # raise ConfigError

    @cached_property
    def conditions(self) -> list[Condition]:
        """The conditions of ``--flag``. Raise ConfigError if one is wrong, or ``--fail-flagged`` has none."""
        return conditions_of(self.flag) if self.flag or self.fail_flagged else []

    @cached_property
    def execution(self) -> Execution:
        """The options for execution. Raise ConfigError for an invalid number, size or shard."""
        if self.jobs != "auto" and not (self.jobs.isdecimal() and 1 <= int(self.jobs) <= _MAX_JOBS):
            raise ConfigError(f"--jobs: must be auto, or 1 to {_MAX_JOBS} (got {self.jobs!r})")
        return Execution(
            jobs=None if self.jobs == "auto" else int(self.jobs),
            threads=self.threads,
            max_memory=parse_bytes(self.max_memory) if self.max_memory else None,
            overwrite=self.overwrite,
            shard=shard_of(self.shard, os.environ),
            fail_fast=self.fail_fast,
            keep=tuple(filter(None, map(str.strip, (self.keep or "").split(",")))),
            scheduler=self.scheduler,
        )


@dataclass(frozen=True, kw_only=True)
class ScoredRunOptions(RunOptions):
    """Options of a run whose results can be compared with the input's ground truth."""

    evaluate: bool = option(False, "--evaluate", help="Compare the results with the input's ground truth.")
    html: HtmlOption = False

    def __post_init__(self) -> None:
        """Raise ConfigError as for any run, and if a part of the scenes would be evaluated."""
        super().__post_init__()
        if self.execution.shard is not None and (self.evaluate or self.html):
            raise ConfigError("--evaluate needs all scenes: run depthcli evaluate when all shards are done")


@dataclass(frozen=True, kw_only=True)
class ScoringOptions:
    """Settings of protocols; each takes some of them."""

    resolution: str | None = option(
        None, metavar="F|H|Q", help="Size of Middlebury v3's ground truth. Default: by the width."
    )
    resize: str | None = option(None, metavar="WxH", help="Resize depth maps and ground truth to this size.")
    threshold: float | None = option(
        None, metavar="T", min=1e-6, help="Error above which a pixel is incorrect. Default: the benchmark's."
    )

    def settings(self, scale: float | None, invalid: float | None) -> Settings:
        """Return the settings, with the coding of all maps. Raise ConfigError for an impossible size or resolution."""
        from depthcli.evaluation.protocols import Settings

        size = None
        if self.resize is not None:
            found = re.fullmatch(r"([1-9]\d{0,4})x([1-9]\d{0,4})", self.resize.strip().lower())
            if found is None:
                raise ConfigError(f"--resize: expected WIDTHxHEIGHT, such as 256x144 (got {self.resize!r})")
            size = int(found[1]), int(found[2])
        return Settings(scale, (self.resolution or "").upper() or None, self.threshold, size, invalid)


@dataclass(frozen=True, kw_only=True)
class SampleOptions:
    """Options for generated scenes; each kind uses some of them."""

    count: int = option(6, "--count", "-n", metavar="N", min=1, max=10_000, help="Number of scenes.")
    kind: list[str] | None = option(
        None,
        "--kind",
        metavar="KIND",
        help="planes, foreground, repetitive, curved, street; repeatable. Default: the first four.",
    )
    seed: int = option(0, metavar="N", min=0, max=2**31 - 1, help="Seed of the first scenes.")
    width: int = option(400, metavar="N", min=16, max=8192, help="Width, pixels.")
    height: int = option(300, metavar="N", min=16, max=8192, help="Height, pixels.")
    max_disparity: int = option(48, metavar="N", min=4, max=4096, help="Largest disparity, at most width / 2.")
    noise: float = option(0.0, metavar="LEVELS", min=0, max=100, help="Standard deviation of noise, in levels.")
    radiometric: float = option(0.0, metavar="SHARE", min=0, max=1, help="Change of light in the right image.")
    brightness: float = option(1.0, metavar="SHARE", min=0, max=1, help="Factor on all levels; 0.08: a night scene.")
    wall_contrast: float = option(1.0, metavar="SHARE", min=0, max=1, help="Texture of the walls, 0 (bare) to 1.")
    real: bool = option(False, "--real", help="A real pair with ground truth: Motorcycle of Middlebury 2014.")
    cross_modal: bool = option(False, "--cross-modal", help="Right image like one of an infrared camera.")
    kinect: bool = option(False, "--kinect", help="Color, and depth as a Kinect measures it.")
    registration: bool = option(False, "--registration", help="Volumes with a known smooth registration error.")
    transparent: bool = option(False, "--transparent", help="Transparent objects, with sparse depth.")
    speckles: float = option(0.0, metavar="SHARE", min=0, max=1, help="Share of the right pixels with a dot.")
    frames: int = option(10, metavar="N", min=0, max=100_000, help="Frames of a sequence; 0: none.")
    fattening: int = option(4, metavar="PIXELS", min=0, max=64, help="Pixels by which foreground is widened.")
    share: float = option(0.02, metavar="SHARE", min=0, max=1, help="Share of the pixels with sparse depth.")
    outliers: float = option(0.1, metavar="SHARE", min=0, max=1, help="Share of the sparse depth that is incorrect.")
    at_edges: bool = option(False, "--at-edges", help="Sparse depth along edges of color only.")
    from_: Path | None = option(None, "--from", metavar="DIR", help="Make them from the scenes in this folder.")


@dataclass(frozen=True, kw_only=True)
class BoardOptions:
    """The printed board."""

    board: Annotated[str, Option(metavar="BOARD", help="COLUMNSxROWS: inner corners; charuco:COLUMNSxROWS: squares.")]
    square: Annotated[str, Option(metavar="LENGTH", help="Edge of a square, with its unit (mm, cm, m).")]
    marker: str | None = option(None, metavar="LENGTH", help="Edge of a marker of a ChArUco board.")
    dictionary: str = option("4X4_50", metavar="NAME", help="Markers of a ChArUco board.")


@dataclass(frozen=True, kw_only=True)
class RectifyOptions(CalibrationOptions):
    """Options for rectification."""

    uncalibrated: bool = option(
        False, "--uncalibrated", help="Rectify by matched key points alone; depths stay unknown."
    )


@dataclass(frozen=True, kw_only=True)
class MapOptions(CalibrationOptions):
    """The maps of a run, or a single map, with their calibration."""

    run: Annotated[Path, Argument(metavar="RUN", help="Run folder of stereo or fuse, or one disparity map.")]
    input: InputOption = None
    layout: LayoutOption = None
    scenes: ScenesOption = None
    left: Path | None = option(None, metavar="FILE", help="Left image of a single map, for the point cloud.")
    focal: float | None = option(None, metavar="PIXELS", min=1e-6, help="Focal length, if there is no calibration.")
    baseline: float | None = option(None, metavar="METERS", min=1e-9, help="Distance of the cameras, with --focal.")
    doffs: float | None = option(None, metavar="PIXELS", help="x of the right principal point minus the left one's.")
    scale: float | None = option(None, metavar="CODES", min=1e-6, help="Codes per pixel of a single map.")
    invalid: float | None = option(None, metavar="VALUE", help="Number in a single map that means no value, or nan.")


@dataclass(frozen=True, kw_only=True)
class CloudOptions:
    """Selection of the pixels that get a depth and of the points of clouds."""

    mask: str | None = option(
        None,
        metavar="WHICH",
        help="Pixels that get a depth: all, measured, or confident:0.8, the 80 % of the measured pixels with the "
        "highest confidence (confident:0.8:NAME if there are several). Default: all; in clouds: measured.",
    )
    ply: bool = option(False, "--ply", help="Also write a colored point cloud of every scene.")
    near: float = option(0.0, metavar="METERS", min=0, help="Nearest depth of point clouds.")
    far: float | None = option(None, metavar="METERS", min=0, help="Farthest depth of point clouds.")
    max_bound: float | None = option(None, metavar="METERS", min=0, help="Largest bound of the error in point clouds.")
    depth_scale: float = option(1000.0, metavar="CODES", min=1e-3, max=1e6, help="Codes per meter in depth.png.")
