"""Frames of SUN RGB-D."""

from __future__ import annotations

from pathlib import Path

from depthcli.core.errors import InputError
from depthcli.io.formats.files import naming, read_bytes
from depthcli.io.formats.images import IMAGE_SUFFIXES
from depthcli.io.formats.plain_text import numbers
from depthcli.io.layouts import Folder, Layout
from depthcli.io.layouts.rgbd import frame
from depthcli.io.scenes import Scene
from depthcli.io.scenes.rgbd import RgbdScene


class SunRgbd(Layout):
    """Color with depth in millimeters, stored as 16 bits that are rotated left by 3."""

    kind = RgbdScene
    wants = "`image/`, `depth/` and `intrinsics.txt`; with `--layout sun-rgbd` also `color.*`, `depth.*`"

    def scenes(self, folder: Folder) -> list[Scene]:
        if folder.has("image", "depth", "intrinsics.txt"):
            color, depth = (_only(folder.path / where) for where in ("image", "depth"))
            fx, _, cx, _, fy, cy = _matrix(folder.path / "intrinsics.txt")
            return [frame(self, folder, color, depth, rotated=True, intrinsics=(fx, fy, cx, cy))]
        color_file, depth_file = folder.one("color", IMAGE_SUFFIXES), folder.one("depth", IMAGE_SUFFIXES)
        if folder.requested != self.name or color_file is None or depth_file is None:
            return []
        return [frame(self, folder, color_file, depth_file, rotated=True)]


def _only(path: Path) -> Path:
    folder = Folder(path, "", "")
    files = sorted(name for name in folder.names if Path(name).suffix.lower() in IMAGE_SUFFIXES)
    if len(files) != 1:
        raise InputError(f"{path}: want one image, there are {len(files)}")
    return path / files[0]


def _matrix(path: Path) -> list[float]:
    """fx, skew, cx, 0, fy, cy: the first two rows of a 3 x 3 matrix."""
    text = read_bytes(path).decode("ascii", "replace")
    with naming(path):
        values = numbers(text, "the camera matrix").tolist()
        if len(values) < 9 or min(values[0], values[4]) <= 0:
            raise InputError("want the nine numbers of a camera matrix")
        return list(values[:6])
