"""Turn disparity maps into metric depth and point clouds.

The calibration is in the folder of the run's images (``calib.txt`` of Middlebury, ETH3D and of
``rectify``, KITTI's files), or is given by options.

Examples:
  depthcli depth runs/accurate --output depth --ply --far 10
  depthcli depth disp_left.pfm --focal 700 --baseline 0.12 --output depth
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import partial
from typing import Any

from depthcli.commands._options import CloudOptions, HtmlOption, MapOptions, RunOptions
from depthcli.core.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class DepthRunOptions(RunOptions):
    """The options of a run without ground truth, with a page."""

    html: HtmlOption = False

    def __post_init__(self) -> None:
        """Raise ConfigError as for any run, and if a part of the scenes would be on the page."""
        super().__post_init__()
        if self.execution.shard is not None and self.html:
            raise ConfigError("--html needs all scenes: run depthcli depth with it when all shards are done")


def depth(maps: MapOptions, clouds: CloudOptions, run: DepthRunOptions) -> int:
    """Compute the depth of every map of the run; return the exit code."""
    from depthcli.commands._run import run_job
    from depthcli.io.scenes.find import scenes_at
    from depthcli.io.scenes.pairs import PAIRS
    from depthcli.io.scenes.places import local
    from depthcli.problems.depth import ToDepth, find_maps
    from depthcli.problems.rectified import calibration_of

    numbers = {name: getattr(maps, name) for name in ("focal", "baseline", "doffs")}
    given = [name for name, value in numbers.items() if value is not None]
    if given and maps.calibration is not None:
        raise ConfigError(f"--calibration and --{given[0]} exclude each other")
    coding: dict[str, Any] = {name: v for name in ("scale", "invalid") if (v := getattr(maps, name)) is not None}
    if coding and not os.path.isfile(local(maps.run)):
        raise ConfigError(f"--{next(iter(coding))} belongs to a single map; maps of a run are in pixels")
    # ``calibration_of`` checks options of a calibration: without a file, those of the one beside the images.
    files, settings = maps.calibration or [], {"calibration": "of the images"}
    settings |= {key: value for key, value in maps.settings().items() if value is not None}
    reading = calibration_of(settings)
    names = [key.partition(".")[2] for key in settings if "." in key]
    fields = {name: getattr(reading, name) for name in names}
    if given and fields:
        raise ConfigError(f"--{next(iter(fields))} and --{given[0]} exclude each other")
    coding |= {name: list(value) if isinstance(value, tuple) else value for name, value in fields.items()}
    coding |= {"second_calibration": str(files[1].absolute())} if len(files) == 2 else {}
    job = ToDepth(numbers | vars(clouds) | coding)
    pairs = None
    if (place := maps.input) is not None:
        pairs = partial(scenes_at, place, PAIRS, maps.layout, ["*"], run.reporter.info)
    scenes = find_maps(maps.run, maps.scenes or ["*"], maps.left, files[0] if files else None, bool(given), pairs)
    return run_job(job, scenes, run, html=run.html)
