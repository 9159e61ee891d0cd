"""Sequences of KITTI odometry."""

from __future__ import annotations

from depthcli.io.layouts import Folder, Layout
from depthcli.io.layouts.views import view_images
from depthcli.io.scenes import Scene
from depthcli.io.scenes.stereo import StereoScene

_VIEWS = (("image_2", "image_3"), ("image_0", "image_1"))
_MAX_DISPARITY = 255  # as of the other KITTI sets, which come without a range of their own


class KittiOdometry(Layout):
    """One folder per sequence; the color images where there are any, else the grey ones."""

    kind = StereoScene
    protocol = "kitti_2015"
    wants = "`image_2`, `image_3` or `image_0`, `image_1` with `000000.png`; `calib.txt`"

    def scenes(self, folder: Folder) -> list[Scene]:
        for left_view, right_view in _VIEWS:
            if not folder.has(left_view, right_view):
                continue
            left, right = (view_images(folder.path / view, (".png",)) for view in (left_view, right_view))
            frames = sorted(name for name in {**left, **right} if name.isdigit())
            if frames:
                return [
                    self.scene(
                        folder,
                        name=folder.prefix + name,
                        problem="" if name in left and name in right else f"{folder.path}: {name}.png lacks a view",
                        left=left.get(name, folder.path / left_view / f"{name}.png"),
                        right=right.get(name),
                        max_disparity=_MAX_DISPARITY,
                        calibration=folder.one("calib", (".txt",)),
                        cameras=(2, 3) if left_view == "image_2" else (0, 1),
                    )
                    for name in frames
                ]
        return []
