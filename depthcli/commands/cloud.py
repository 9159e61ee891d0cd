"""Join the point clouds of frames by their poses.

Every frame has a cloud in its camera's coordinates (``points.ply`` of ``depth --ply`` or ``refine-kinect --ply``). They
are moved to where the camera was, and all points in a small cube become one.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from depthcli.commands._options import LAYOUT, SCENES
from depthcli.core.errors import ConfigError, InputError
from depthcli.core.option import Option
from depthcli.run.command import SOME_FAILED, Command, Values
from depthcli.run.console import Reporter, aligned
from depthcli.run.json_csv import Row, to_json

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_FILE = "points.ply"
_MAX_LEVELS = 3  # folders of a run above a cloud: data set, sequence, frame
_MAX_NAMED = 6  # frames that a message names


class CloudCommand(Command):
    """``depthcli cloud RUN --input FRAMES --output cloud.ply``."""

    arguments = (Option("run", Path, "Run with points.ply of every frame.", "RUN", required=True, group="Input"),)

    options = (
        Option("input", Path, "Folder of the run's frames, with their poses.", "DIR", short="-i", required=True,
               group="Input"),
        LAYOUT,
        SCENES,
        Option("output", Path, "The cloud to write.", "FILE.ply", short="-o", required=True, group="Output"),
        Option("voxel", float, "Edge of a cube that becomes one point.", "METERS", default=0.01, min_value=1e-4,
               max_value=100.0),
        Option("overwrite", bool, "Replace the cloud.", default=False, group="Output"),
    )  # fmt: skip

    page = "how_to/recordings"
    examples = ("depthcli cloud runs/room --input frames --output room.ply",)

    def run(self, values: Values, reporter: Reporter) -> int:
        """Join the clouds; return the exit code, 3 where that of a frame, or its pose, is missing or damaged."""
        import numpy as np

        from depthcli.algorithms.voxel_grid import VoxelGrid
        from depthcli.io.formats.depth import read_points, write_points
        from depthcli.io.formats.files import remove_temporaries

        target: Path = values["output"]
        if os.path.lexists(target) and not values["overwrite"]:
            raise ConfigError(f"{target}: is there already; choose another --output, or --overwrite it")
        clouds = _clouds(values["run"], values["scenes"] or ["*"])
        poses = _poses(values, reporter)
        grid, n_points, problems, used = VoxelGrid(values["voxel"]), 0, list[str](), 0
        with reporter:
            reporter.start(len(clouds), 0, "join")
            for name, file in clouds.items():
                try:
                    pose = _pose(name, poses)
                    points, color = read_points(file)
                    grid.add(points.astype(np.float64) @ pose[:3, :3].T + pose[:3, 3], color)
                    n_points, used = n_points + len(points), used + 1
                except InputError as error:
                    problems.append(f"{name}: {error}")
                reporter.step()
        for line in problems[:_MAX_NAMED]:
            reporter.error(line)
        if len(problems) > _MAX_NAMED:
            reporter.error(f"and {len(problems) - _MAX_NAMED} more frames")
        if not used:
            raise InputError(f"{values['run']}: no frame has a cloud and a pose")
        joined, color = grid.points()
        far = float(np.abs(joined).max()) if len(joined) else 0.0
        if far * np.finfo(np.float32).eps > values["voxel"] / 4:
            reporter.error(f"warning: coordinates of {far:.4g} m in 32 bit are coarser than the voxels; move the poses")
        remove_temporaries(target.parent, target.name)
        write_points(target, joined.astype(np.float32), color)
        size = np.ptp(joined, axis=0).tolist() if len(joined) else [0.0, 0.0, 0.0]
        row: Row = {"frames": used, "without": len(problems), "points": n_points, "voxels": len(joined),
                    "size": [round(side, 4) for side in size]}  # fmt: skip
        if values["json"]:
            reporter.data(to_json(row | {"file": str(target)}))
        elif not values["quiet"]:
            extent = " x ".join(f"{side:.2f}" for side in size) + " m"
            titles = ("frames", "without", "points", "voxels", "extent")
            reporter.data(aligned([titles, (*(str(row[key]) for key in titles[:4]), extent)]))
        reporter.info(f"{target}: {len(joined)} points of {used} frames")
        return SOME_FAILED if problems else 0


def _clouds(run: Path, patterns: Sequence[str]) -> dict[str, Path]:
    """Return name of a frame -> its cloud, in the order of names."""
    from depthcli.io.walk import matches_any

    if not os.path.isdir(run):
        raise InputError(f"{run}: no such run folder")
    found = {}
    for depth in range(1, _MAX_LEVELS + 1):
        for file in run.glob("/".join(["*"] * depth + [_FILE])):
            name = file.parent.relative_to(run).as_posix()
            if not any(part.startswith(".") for part in name.split("/")):
                found[name] = file
    if not found:
        raise InputError(f"{run}: no {_FILE} of any frame; write them by depth --ply or refine-kinect --ply")
    chosen = {name: found[name] for name in sorted(found) if matches_any(name, patterns)}
    if not chosen:
        raise InputError(f"{run}: no frame matches {', '.join(patterns)}")
    rectified = _rectified_for_maps(run)
    if wrong := [name for name in chosen if name in rectified]:
        raise InputError(
            f"{run}: {wrong[0]} was rectified while it was matched, which turns its camera against the pose; run "
            "depthcli rectify on the frames, match its result, and give that as the frames"
        )
    return chosen


def _rectified_for_maps(run: Path) -> set[str]:
    """Return the frames of a run of ``depth`` whose maps lie beside an image that was rectified for them."""
    from depthcli.run.reports import read_report

    places = {name: Path(str(row["source"])).parent for name, row in read_report(run).items() if row.get("source")}
    return {
        name
        for name, place in places.items()
        if all(os.path.isfile(place / file) for file in ("disp_left.pfm", "left.png", "calib.txt"))
    }


def _poses(values: Values, reporter: Reporter) -> dict[str, tuple[float, ...] | None]:
    """Return name of a frame -> its pose."""
    from depthcli.io.scenes.rgbd import RgbdScene
    from depthcli.io.scenes.stereo import StereoScene
    from depthcli.io.walk import discover_scenes

    scenes = discover_scenes(values["input"], (StereoScene, RgbdScene), values["layout"], warn=reporter.info)
    poses = {scene.name: scene.pose for scene in scenes if isinstance(scene, StereoScene | RgbdScene)}
    if not any(poses.values()):
        raise InputError(
            f"{values['input']}: no frame has a pose; want poses.txt beside them, groundtruth.txt of TUM, or pose in "
            "meta.json"
        )
    return poses


def _pose(name: str, poses: Mapping[str, tuple[float, ...] | None]) -> NDArray[np.float64]:
    import numpy as np

    if name not in poses:
        raise InputError("no frame of that name in the input")
    pose = poses[name]
    if pose is None:
        raise InputError("has no pose")
    return np.array(pose).reshape(4, 4)


COMMAND = CloudCommand()
