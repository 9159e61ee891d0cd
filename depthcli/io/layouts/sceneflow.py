"""FlyingThings3D, Driving and Monkaa: the Scene Flow datasets (Mayer et al., CVPR 2016)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from depthcli.io.layouts import Folder, Layout
from depthcli.io.layouts._trees import existing, files_below
from depthcli.io.scenes import Scene
from depthcli.io.scenes.stereo import StereoScene

_PASSES = ("frames_cleanpass", "frames_finalpass", "image_clean", "image_final")  # the latter two: of the subset
_TRUTHS = ("disparity", "frames_disparity")
_MAX_DISPARITY = 192  # range of the evaluations in the literature; the files have larger ones, too


class SceneFlowScene(StereoScene):
    """A frame whose left disparities may be negative, as in the subset of FlyingThings3D for DispNet."""

    def decode(self, file: Path, scale: float | None) -> NDArray[np.float32]:
        disparity = super().decode(file, scale)
        return -disparity if np.count_nonzero(disparity < 0) > np.count_nonzero(disparity > 0) else disparity


class Sceneflow(Layout):
    """Frames of the clean and the final pass, with disparities of both views; depth would be in units of the renderer.

    The focal length is 1050 px, 450 px in the scenes of Driving with 15 mm, and the baseline 1 unit.
    """

    kind = SceneFlowScene
    protocol = "scene_flow"
    wants = (
        "`frames_cleanpass/**/left/0006.png`, `right/0006.png`, `disparity/**/left/0006.pfm` (FlyingThings3D, Driving, "
        "Monkaa; or `frames_finalpass`); of the subset `image_clean`, `disparity_occlusions`"
    )

    def scenes(self, folder: Folder) -> list[Scene]:
        frames = [
            (folder.path / name, left)
            for name in _PASSES
            if name in folder.names
            for left in files_below(folder.path / name, (".png", ".webp"))
            if left.parent.name == "left"
        ]
        truth = next((name for name in _TRUTHS if name in folder.names), _TRUTHS[0])
        return [self._frame(folder, place, left, folder.path / truth) for place, left in frames]

    def _frame(self, folder: Folder, place: Path, left: Path, truth: Path) -> Scene:
        right = existing(left.parent.with_name("right") / left.name)
        where = left.relative_to(place)
        problem = "" if right else f"{left}: only one image of the pair, no right/{left.name}"
        if left.suffix.lower() == ".webp":
            problem = f"{left}: WebP is not read; want the set's PNG images"
        beside = (truth / where).with_suffix(".pfm")
        return self.scene(
            folder,
            name=f"{folder.prefix}{place.name}/{'_'.join([*where.parts[:-2], left.stem])}",
            problem=problem,
            left=left,
            right=right,
            disparity_left=existing(beside),
            disparity_right=existing(beside.parent.with_name("right") / beside.name),
            occluded=existing(folder.path / "disparity_occlusions" / where),
            max_disparity=_MAX_DISPARITY,
        )
