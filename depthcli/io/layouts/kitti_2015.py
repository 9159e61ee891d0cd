"""The folders of KITTI 2015."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

from depthcli.io.formats.disparity import KITTI_SCALE
from depthcli.io.layouts import Folder, Layout
from depthcli.io.scenes import Scene
from depthcli.io.scenes.stereo import StereoScene

_MAX_DISPARITY = 255  # the largest disparity a file can hold: the frames come without a range of their own


class Kitti2015(Layout):
    """One folder per view and one per kind of truth; a frame has the same name in each."""

    kind = StereoScene
    wants = "`image_2`, `image_3`, `disp_noc_0`, `disp_occ_0`, `obj_map`, `calib_cam_to_cam`"
    protocol = "kitti_2015"
    views: ClassVar[tuple[tuple[str, str], ...]] = (("image_2", "image_3"),)
    truths: ClassVar[tuple[str, str, str]] = ("disp_occ_0", "disp_noc_0", "obj_map")
    calibrations: ClassVar[str] = "calib_cam_to_cam"

    def scenes(self, folder: Folder) -> list[Scene]:
        views = next((pair for pair in self.views if folder.has(pair[0])), None)
        if views is None:
            return []
        scenes: list[Scene] = []
        place = folder.path / views[0]
        for left in sorted(place.glob("*_10.png")):
            right, occ, noc, objects = (_beside(folder, where, left) for where in (views[1], *self.truths))
            frame = left.with_name(left.stem.partition("_")[0] + ".txt")
            scenes.append(
                self.scene(
                    folder,
                    name=folder.prefix + left.stem,
                    problem="" if right or occ else f"{folder.path}: {views[1]}/{left.name} is missing",
                    left=left,
                    right=right,
                    disparity_left=occ,
                    disparity_noc=noc,
                    disparity_scale=KITTI_SCALE,
                    objects=objects,
                    max_disparity=_MAX_DISPARITY,
                    calibration=_beside(folder, self.calibrations, frame),
                    cameras=(0, 1) if views[0] == "image_0" else (2, 3),
                )
            )
        return scenes


def _beside(folder: Folder, where: str, left: Path) -> Path | None:
    path = folder.path / where / left.name
    return path if where in folder.names and path.is_file() else None
