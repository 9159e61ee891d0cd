"""One folder per view."""

from __future__ import annotations

from pathlib import Path

from depthcli.core.errors import InputError
from depthcli.io.formats.images import IMAGE_SUFFIXES
from depthcli.io.formats.map_format import map_suffixes
from depthcli.io.layouts import Folder, Layout
from depthcli.io.scenes import Scene
from depthcli.io.scenes.stereo import StereoScene

# Folders of the left and the right view that are recognized.
_VIEWS = (
    ("left", "right"), ("Left", "Right"), ("l", "r"), ("L", "R"), ("image_left", "image_right"),
    ("left_images", "right_images"), ("cam0", "cam1"), ("cam0/data", "cam1/data"),
)  # fmt: skip


class Views(Layout):
    """The two images of a pair have one name, in two folders."""

    kind = StereoScene
    wants = (
        "`left/NAME.*`, `right/NAME.*` (also `image_left`, `cam0`, `cam0/data`); where known `disp_left/NAME.*`, and "
        "`calib.txt`, `meta.json` of all pairs"
    )

    def scenes(self, folder: Folder) -> list[Scene]:
        for left, right in _VIEWS:
            if folder.has(left.partition("/")[0], right.partition("/")[0]):
                sides = [view_images(folder.path / side, IMAGE_SUFFIXES) for side in (left, right)]
                if set(sides[0]) & set(sides[1]):
                    truth = view_images(folder.path / "disp_left", map_suffixes()) if folder.has("disp_left") else {}
                    return pair_scenes(self, folder, sides[0], sides[1], truth)
        return []


def pair_scenes(
    layout: Layout, folder: Folder, left: dict[str, Path], right: dict[str, Path], truth: dict[str, Path]
) -> list[Scene]:
    """Return a scene for every name of either view; the folder's meta.json and calib.txt are those of all."""
    scenes = []
    names = sorted({**left, **right})
    for name in names:
        one, other = left.get(name), right.get(name)
        problem = ""
        if one is None or other is None:
            problem = f"{one or other}: only one image of the pair, no {'right' if one else 'left'} one"
        scenes.append(
            layout.scene(
                folder,
                name=folder.prefix + name,
                protocol=folder.meta.text("protocol", "middlebury_v2"),
                problem=problem,
                left=one or folder.path / f"{name}.png",
                right=other,
                disparity_left=truth.get(name),
                disparity_scale=folder.meta.positive("disp_scale"),
                calibration=folder.one("calib", (".txt",)),
                **folder.meta.disparities(),
            )
        )
    return scenes


def view_images(place: Path, suffixes: tuple[str, ...]) -> dict[str, Path]:
    """Return stem -> file of a folder; InputError where two files have one stem."""
    if not place.is_dir():
        return {}
    files: dict[str, Path] = {}
    for name in sorted(Folder(place, "", "").names):
        path = place / name
        if path.suffix.lower() in suffixes:
            if path.stem in files:
                raise InputError(f"{place}: both {files[path.stem].name} and {name}; keep one")
            files[path.stem] = path
    return files
