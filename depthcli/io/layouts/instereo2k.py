"""InStereo2K (Bao et al., Science China Information Sciences 2020)."""

from __future__ import annotations

from depthcli.io.formats.images import IMAGE_SUFFIXES
from depthcli.io.layouts import Folder, Layout
from depthcli.io.scenes import Scene
from depthcli.io.scenes.stereo import StereoScene

_SCALE = 100.0  # codes per pixel


class Instereo2k(Layout):
    """A folder per pair, with the disparities of both views."""

    kind = StereoScene
    protocol = "middlebury_v2"
    wants = "`left.png`, `right.png`, `left_disp.png`, `right_disp.png` (codes / 100)"

    def scenes(self, folder: Folder) -> list[Scene]:
        truth = folder.one("left_disp", (".png",))
        if truth is None:
            return []
        left, right = (folder.one(stem, IMAGE_SUFFIXES) for stem in ("left", "right"))
        missing = "left" if left is None else "right" if right is None else ""
        return [
            self.scene(
                folder,
                problem=f"{folder.path}: only one image of the pair, no {missing}.png" if missing else "",
                left=left or folder.path / "left.png",
                right=right,
                disparity_left=truth,
                disparity_right=folder.one("right_disp", (".png",)),
                disparity_scale=_SCALE,
            )
        ]
