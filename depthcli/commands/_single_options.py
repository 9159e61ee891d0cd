"""Groups of options that one command alone has, beside those of ``_options``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from depthcli.commands._shared_options import InputOption, LayoutOption, ScenesOption, option


@dataclass(frozen=True, kw_only=True)
class SampleOptions:
    """The scenes that are generated; each kind takes some of the options."""

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
    max_disparity: int = option(48, metavar="N", min=4, max=4096, help="At most width / 2.")
    noise: float = option(0.0, metavar="LEVELS", min=0, max=100, help="Standard deviation of noise, in levels.")
    radiometric: float = option(0.0, metavar="SHARE", min=0, max=1, help="Change of light in the right image.")
    brightness: float = option(1.0, metavar="SHARE", min=0, max=1, help="Factor on all levels; 0.08: a night scene.")
    wall_contrast: float = option(1.0, metavar="SHARE", min=0, max=1, help="Texture of the walls, 0 (bare) to 1.")
    cross_modal: bool = option(False, "--cross-modal", help="Right image as an infrared camera's.")
    kinect: bool = option(False, "--kinect", help="Color, and depth as a Kinect measures it.")
    registration: bool = option(False, "--registration", help="Volumes with a known smooth registration error.")
    transparent: bool = option(False, "--transparent", help="Transparent objects, with sparse depth.")
    speckles: float = option(0.0, metavar="SHARE", min=0, max=1, help="Share of the right pixels with a dot.")
    frames: int = option(10, metavar="N", min=0, max=100_000, help="Frames of a sequence; 0: none.")
    fattening: int = option(4, metavar="PIXELS", min=0, max=64, help="How far foreground is widened.")
    share: float = option(0.02, metavar="SHARE", min=0, max=1, help="Share of the pixels with sparse depth.")
    outliers: float = option(0.1, metavar="SHARE", min=0, max=1, help="Share of it that is wrong.")
    at_edges: bool = option(False, "--at-edges", help="Sparse depth along edges of color only.")
    from_: Path | None = option(None, "--from", metavar="DIR", help="Make them from the scenes of this folder instead.")


@dataclass(frozen=True, kw_only=True)
class BoardOptions:
    """The board, as it is printed."""

    board: Annotated[str, Option(metavar="BOARD", help="COLUMNSxROWS: inner corners; charuco:COLUMNSxROWS: squares.")]
    square: Annotated[str, Option(metavar="LENGTH", help="Edge of a square, with its unit (mm, cm, m).")]
    marker: str | None = option(None, metavar="LENGTH", help="Edge of a marker of a ChArUco board.")
    dictionary: str = option("4X4_50", metavar="NAME", help="Markers of a ChArUco board.")


@dataclass(frozen=True, kw_only=True)
class RectifyOptions:
    """By what pairs are rectified."""

    calibration: list[Path] | None = option(
        None,
        metavar="FILE",
        help="Calibration: OpenCV (YAML, XML), ROS camera_info (left, then right), Kalibr camchain or KITTI "
        "calib_cam_to_cam; repeatable.",
    )
    uncalibrated: bool = option(
        False, "--uncalibrated", help="Rectify by matched key points alone; depths stay unknown."
    )
    unit: str = option("m", metavar="UNIT", help="Unit of the translation in an OpenCV calibration: m, cm or mm.")
    fisheye: bool = option(False, "--fisheye", help="The lenses of an OpenCV file are fisheye.")
    cameras: str = option("2,3", metavar="L,R", help="Numbers of the left and right camera in a KITTI file.")
    alpha: float = option(
        0.0, metavar="SHARE", min=0, max=1, help="0: keep only what both images show; 1: keep all of both."
    )


@dataclass(frozen=True, kw_only=True)
class MapOptions:
    """The maps of a run, or a single one, and their calibration."""

    run: Annotated[Path, Argument(metavar="RUN", help="Run folder of stereo or fuse, or one disparity map.")]
    input: InputOption = None
    layout: LayoutOption = None
    scenes: ScenesOption = None
    left: Path | None = option(None, metavar="FILE", help="Left image of a single map, for the point cloud.")
    calibration: Path | None = option(None, metavar="FILE", help="Calibration of all scenes: calib.txt, or KITTI's.")
    focal: float | None = option(None, metavar="PIXELS", min=1e-6, help="Focal length, if there is no calibration.")
    baseline: float | None = option(None, metavar="METERS", min=1e-9, help="Distance of the cameras, with --focal.")
    doffs: float | None = option(None, metavar="PIXELS", help="x of the right principal point minus the left one's.")


@dataclass(frozen=True, kw_only=True)
class CloudOptions:
    """Which pixels get a depth, and which are points of a cloud."""

    mask: str | None = option(
        None,
        metavar="WHICH",
        help="Pixels that get a depth: all, measured, or confident:0.8, the 80 % of the measured ones with the "
        "highest confidence (confident:0.8:NAME of several). Default: all, in clouds measured.",
    )
    ply: bool = option(False, "--ply", help="Also write a colored point cloud of every scene.")
    near: float = option(0.0, metavar="METERS", min=0, help="Nearest depth of point clouds.")
    far: float | None = option(None, metavar="METERS", min=0, help="Farthest depth of point clouds.")
    depth_scale: float = option(1000.0, metavar="CODES", min=1e-3, max=1e6, help="Codes per meter in depth.png.")
