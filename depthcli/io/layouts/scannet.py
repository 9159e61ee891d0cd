"""ScanNet (Dai et al., CVPR 2017), as its reader of .sens files exports it, or its selection of 25,000 frames."""

from __future__ import annotations

from pathlib import Path

from depthcli.core.errors import InputError
from depthcli.io.formats.files import naming, read_bytes
from depthcli.io.formats.images import IMAGE_SUFFIXES
from depthcli.io.formats.plain_text import numbers
from depthcli.io.layouts import Folder, Layout
from depthcli.io.layouts.rgbd import frame
from depthcli.io.layouts.rgbd_sequence import numbered
from depthcli.io.scenes import Scene
from depthcli.io.scenes.rgbd import RgbdScene

_KINDS = ("color", "depth")
_NAMES = ("intrinsic/intrinsic_{}.txt", "intrinsics_{}.txt")


class Scannet(Layout):
    """A folder per recording; depth in millimeters of a smaller camera, which is registered to the color image."""

    kind = RgbdScene
    protocol = "depth"
    wants = (
        "`color/0.jpg`, `depth/0.png` (millimeters), `intrinsic/intrinsic_color.txt`, `intrinsic/intrinsic_depth.txt`"
    )

    def scenes(self, folder: Folder) -> list[Scene]:
        if not folder.has(*_KINDS) or not ("intrinsic" in folder.names or "intrinsics_color.txt" in folder.names):
            return []
        color_camera, depth_camera = (_camera(folder.path, kind) for kind in _KINDS)
        colors, depths = (numbered(Folder(folder.path / kind, "", ""), "", IMAGE_SUFFIXES) for kind in _KINDS)
        scenes: list[Scene] = []
        for number in sorted({*colors, *depths}):
            color, depth = colors.get(number), depths.get(number)
            there = color or depth
            assert there is not None
            missing = "color" if color is None else "" if depth else "depth"
            scenes.append(
                frame(self, folder, color or there, depth or there, name=f"{folder.prefix}{there.stem}",
                      problem=f"{there}: a frame without its {missing}" if missing else "", sequence=folder.name,
                      number=number, intrinsics=color_camera, depth_intrinsics=depth_camera)
            )  # fmt: skip
        return scenes


def _camera(place: Path, kind: str) -> tuple[float, float, float, float]:
    """Focal lengths and principal point of a camera's matrix of 4 x 4 numbers."""
    path = next((path for name in _NAMES if (path := place / name.format(kind)).is_file()), None)
    if path is None:
        raise InputError(f"{place}: no {_NAMES[0].format(kind)}, which the depth is registered by")
    with naming(path):
        matrix = numbers(read_bytes(path).decode("ascii", "replace"), "the camera matrix")
        if matrix.size not in (9, 16) or min(matrix[0], matrix[5 if matrix.size == 16 else 4]) <= 0:
            raise InputError("want the numbers of a camera matrix, 4 x 4")
    rows = matrix.reshape(-1, 4 if matrix.size == 16 else 3)
    return float(rows[0, 0]), float(rows[1, 1]), float(rows[0, 2]), float(rows[1, 2])
