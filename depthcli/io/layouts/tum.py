"""Sequences of the TUM RGB-D benchmark."""

from __future__ import annotations

from pathlib import Path

from depthcli.core.errors import InputError
from depthcli.io.formats.files import read_bytes
from depthcli.io.formats.poses import Poses, read_poses
from depthcli.io.layouts import Folder, Layout
from depthcli.io.layouts.rgbd import frame
from depthcli.io.scenes import Scene
from depthcli.io.scenes.rgbd import RgbdScene

_DEPTH_SCALE = 5000.0  # codes a meter, of the benchmark's files
_MAX_DELAY = 0.02  # seconds, as the benchmark's associate.py


class Tum(Layout):
    """Color and depth images, each with a time, paired by ``associations.txt`` or by the nearest time."""

    kind = RgbdScene
    wants = (
        "`rgb/`, `depth/` with `associations.txt`, or `rgb.txt` and `depth.txt`; 5000 codes a meter; where known "
        "`groundtruth.txt` (poses)"
    )

    def scenes(self, folder: Folder) -> list[Scene]:
        if not folder.has("rgb", "depth") or not (folder.has("associations.txt") or folder.has("rgb.txt", "depth.txt")):
            return []
        if folder.has("associations.txt"):
            pairs = [(float(a), b, float(c), d) for a, b, c, d in _lines(folder.path / "associations.txt", 4)]
            if pairs and pairs[0][1].startswith("depth"):  # associate.py depth.txt rgb.txt
                pairs = [(c, d, a, b) for a, b, c, d in pairs]
        else:
            pairs = _nearest(folder)
        poses = read_poses(folder.path / "groundtruth.txt") if folder.has("groundtruth.txt") else Poses((), ())
        scenes: list[Scene] = []
        for number, (time, color, depth_time, depth) in enumerate(pairs):
            apart = abs(time - depth_time)
            problem = ""
            if apart > _MAX_DELAY:
                problem = (
                    f"{folder.path / color}: the nearest depth is {apart:.3f} s off, at most {_MAX_DELAY} s may be"
                )
            scenes.append(
                frame(self, folder, folder.path / color, folder.path / depth, name=f"{folder.prefix}{time:.6f}",
                      problem=problem, depth_scale=_DEPTH_SCALE, sequence=folder.name, number=number,
                      pose=poses.at(time))
            )  # fmt: skip
        if not scenes:
            raise InputError(f"{folder.path}: no line pairs a color image with a depth image")
        return scenes


def _nearest(folder: Folder) -> list[tuple[float, str, float, str]]:
    depths = sorted((float(time), file) for time, file in _lines(folder.path / "depth.txt", 2))
    if not depths:
        raise InputError(f"{folder.path / 'depth.txt'}: names no file")
    colors = sorted((float(time), file) for time, file in _lines(folder.path / "rgb.txt", 2))
    pairs = []
    for time, color in colors:
        _, depth_time, depth = min((abs(t - time), t, file) for t, file in depths)
        pairs.append((time, color, depth_time, depth))
    return pairs


def _lines(path: Path, fields: int) -> list[list[str]]:
    rows = []
    for number, line in enumerate(read_bytes(path).decode("utf-8", "replace").splitlines(), 1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        try:
            times = [float(word) for word in words[0:fields:2]]
        except ValueError:
            times = []
        if len(words) < fields or len(times) * 2 != fields or any(".." in Path(w).parts for w in words[1:fields:2]):
            raise InputError(f"{path}:{number}: want {'time file ' * (fields // 2)}(got {line[:60]!r})")
        rows.append(words[:fields])
    return rows
