"""Turn disparity maps into metric depth and point clouds.

The calibration is in the folder of the run's images (``calib.txt`` of Middlebury, ETH3D and of
``rectify``, KITTI's files), or is given by options.

Examples:
  depthcli depth runs/accurate --output depth --ply --far 10
  depthcli depth disp_left.pfm --focal 700 --baseline 0.12 --output depth
"""

from __future__ import annotations

from dataclasses import dataclass

from depthcli.commands._options import CloudOptions, MapOptions, RunOptions
from depthcli.commands._shared_options import HtmlOption


@dataclass(frozen=True, kw_only=True)
class DepthRunOptions(RunOptions):
    """The options of a run that has no ground truth, with a page."""

    html: HtmlOption = False


def depth(maps: MapOptions, clouds: CloudOptions, run: DepthRunOptions) -> int:
    """Turn every map of the run into depth; return the exit code."""
    from depthcli.commands._depth import prepare
    from depthcli.commands._run import run_job

    return run_job(*prepare(maps, clouds, run), run)
