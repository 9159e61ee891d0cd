"""Numbered frames of color and depth."""

from __future__ import annotations

import re
from pathlib import Path

from depthcli.core.errors import InputError
from depthcli.io.formats.images import IMAGE_SUFFIXES
from depthcli.io.formats.poses import read_poses
from depthcli.io.layouts import Folder, Layout
from depthcli.io.layouts.rgbd import DEPTH_SUFFIXES, frame
from depthcli.io.scenes import Scene
from depthcli.io.scenes.rgbd import RgbdScene

_NUMBER = re.compile(r"(\d+)$")


class RgbdSequence(Layout):
    """One folder per sequence; color and depth of one number belong together."""

    kind = RgbdScene
    wants = (
        "`color_00000.*` and `depth_00000.*`, or `color/` and `depth/` with numbered files; `meta.json` as `rgbd`; "
        "where known `poses.txt`"
    )

    def scenes(self, folder: Folder) -> list[Scene]:
        if folder.names & {"intrinsic", "intrinsics_color.txt"}:  # of scannet
            return []
        if folder.has("color", "depth"):
            colors = numbered(Folder(folder.path / "color", "", ""), "", IMAGE_SUFFIXES)
            depths = numbered(Folder(folder.path / "depth", "", ""), "", DEPTH_SUFFIXES)
        else:
            colors = numbered(folder, "color_", IMAGE_SUFFIXES)
            depths = {n: f for n, f in numbered(folder, "depth_", DEPTH_SUFFIXES).items() if "true" not in f.stem}
        if not colors or not depths:
            return []
        frames = sorted({**colors, **depths})
        poses = read_poses(folder.path / "poses.txt").of_frames(frames) if folder.has("poses.txt") else {}
        scenes: list[Scene] = []
        for number in frames:
            color, depth = colors.get(number), depths.get(number)
            there = color or depth
            assert there is not None
            digits = _digits(there)
            problem = ""
            if color is None or depth is None:
                problem = f"{there}: a frame without its {'color' if color is None else 'depth'}"
            scenes.append(
                frame(self, folder, color or there, depth or there, name=folder.prefix + digits, problem=problem,
                      sequence=folder.name, number=number, pose=poses.get(number))
            )  # fmt: skip
        return scenes


def numbered(folder: Folder, start: str, suffixes: tuple[str, ...]) -> dict[int, Path]:
    """Return number at the end of the stem -> file, of the files whose names begin with ``start``."""
    files: dict[int, Path] = {}
    for rest, file in folder.starting(start, suffixes).items():
        if _NUMBER.search(rest) and not rest.startswith("true"):
            number = int(_digits(file))
            if number in files:
                raise InputError(f"{folder.path}: both {files[number].name} and {file.name} are frame {number}")
            files[number] = file
    return files


def _digits(file: Path) -> str:
    match = _NUMBER.search(file.stem)
    assert match is not None
    return match[1]
