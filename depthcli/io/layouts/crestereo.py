"""The synthetic set of CREStereo (Li et al., CVPR 2022)."""

from __future__ import annotations

from depthcli.io.layouts import Folder, Layout
from depthcli.io.scenes import Scene
from depthcli.io.scenes.stereo import StereoScene

_SCALE = 32.0  # codes per pixel
_LEFT, _RIGHT = "_left", "_right"


class Crestereo(Layout):
    """Pairs side by side with the disparities of both views, in one folder for each kind of scene."""

    kind = StereoScene
    protocol = "middlebury_v2"
    wants = "`NAME_left.jpg`, `NAME_right.jpg`, `NAME_left.disp.png`, `NAME_right.disp.png` (codes / 32)"

    def scenes(self, folder: Folder) -> list[Scene]:
        if not any(name.endswith(f"{_LEFT}.disp.png") for name in folder.names):
            return []
        truths = folder.starting("", (".png",))
        names = [stem.removesuffix(f"{_LEFT}.disp") for stem in truths if stem.endswith(f"{_LEFT}.disp")]
        scenes: list[Scene] = []
        for name in names:
            left, right = (folder.one(name + side, (".jpg", ".jpeg", ".png")) for side in (_LEFT, _RIGHT))
            missing = _LEFT if left is None else _RIGHT if right is None else ""
            scenes.append(
                self.scene(
                    folder,
                    name=folder.prefix + name,
                    problem=f"{folder.path}: only half of a pair, no {name}{missing}.jpg" if missing else "",
                    left=left or folder.path / f"{name}{_LEFT}.jpg",
                    right=right,
                    disparity_left=truths[f"{name}{_LEFT}.disp"],
                    disparity_right=truths.get(f"{name}{_RIGHT}.disp"),
                    disparity_scale=_SCALE,
                )
            )
        return scenes
