"""Our own layout of stereo scenes."""

from __future__ import annotations

from depthcli.io.formats.images import IMAGE_SUFFIXES
from depthcli.io.formats.map_format import map_suffixes
from depthcli.io.layouts import Folder, Layout
from depthcli.io.scenes import Scene
from depthcli.io.scenes.stereo import StereoScene


class Scenes(Layout):
    """One folder per scene; the name of each file says what it holds."""

    kind = StereoScene
    protocol = "middlebury_v2"
    wants = (
        "`left.*`, `right.*`; where known `disp_left.*`, `disp_right.*`, `mask_<name>.*` (255 = evaluate), `calib.txt` "
        "(as `middlebury-v3`), `meta.json` (`max_disparity`, `min_disparity`, `disp_scale`, `protocol`)"
    )

    def scenes(self, folder: Folder) -> list[Scene]:
        left, right = (folder.one(stem, IMAGE_SUFFIXES) for stem in ("left", "right"))
        if left is None and right is None:
            return []
        suffixes = map_suffixes()
        truth = folder.one("disp_left", suffixes)
        if folder.one("left_disp", (".png",)):  # of instereo2k
            return []
        problem = ""
        if left is None or (right is None and truth is None):
            problem = f"{folder.path}: only one image of the pair, no {'right' if left else 'left'}.*"
        meta = folder.meta
        masks = folder.starting("mask_", IMAGE_SUFFIXES)
        return [
            self.scene(
                folder,
                protocol=meta.text("protocol", self.protocol),
                problem=problem,
                left=left or folder.path / "left.png",
                right=right,
                disparity_left=truth,
                disparity_right=folder.one("disp_right", suffixes),
                disparity_noc=folder.one("disp_left_noc", suffixes),
                disparity_scale=meta.positive("disp_scale"),
                masks={name: file for name, file in masks.items() if not name.endswith("_right")},
                objects=folder.one("objects", IMAGE_SUFFIXES),
                round_disparity=meta.fields.get("isint") is True,
                calibration=folder.one("calib", (".txt",)),
                **meta.disparities(),
            )
        ]
