"""Rectify image pairs, with or without a calibration.

For every scene the rectified pair is written, its calibration as calib.txt, and the search range that matched key
points suggest.

Examples:
  depthcli rectify --input photos --calibration stereo.yaml --output rectified
  depthcli rectify --left l.jpg --right r.jpg --uncalibrated --output pair
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from typer import Option

from depthcli.commands._options import PairOptions, RunOptions


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


def rectify(pairs: PairOptions, how: RectifyOptions, run: RunOptions) -> int:
    """Rectify every pair; return the exit code."""
    from depthcli.commands._rectified import rectify_pairs

    return rectify_pairs(pairs, how, run)
