"""Two-view scenes of ETH3D."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from depthcli.core.errors import InputError
from depthcli.io.layouts import Folder
from depthcli.io.layouts._trees import existing
from depthcli.io.layouts.middlebury_v3 import MiddleburyV3
from depthcli.io.scenes import Scene
from depthcli.io.scenes.stereo import StereoScene

_MANY_VIEWS = ("rig_calibration", "dslr_calibration")  # how folders begin that lie beside ``images`` there


class Eth3d(MiddleburyV3):
    """As Middlebury v3, beside the files of the multi-view benchmark; the truth may lie in a folder beside its own."""

    wants = (
        "as `middlebury-v3`, with `cameras.txt`, `images.txt`; the truth in the scene's folder or in one of "
        "the same name in `two_view_training_gt` beside `two_view_training`"
    )
    protocol = "eth3d"

    def fits(self, folder: Folder) -> bool:
        return folder.has("cameras.txt", "images.txt")

    def scenes(self, folder: Folder) -> list[Scene]:
        if "images" in folder.names and any(name.startswith(_MANY_VIEWS) for name in folder.names):
            raise InputError(
                f"{folder.path}: a many-view scene of ETH3D, without rectified pairs; its two-view scenes can be used"
            )
        return [
            _with_truth(scene, folder.path)
            if isinstance(scene, StereoScene) and scene.disparity_left is None
            else scene
            for scene in super().scenes(folder)
        ]


def _with_truth(scene: StereoScene, path: Path) -> StereoScene:
    """The scene with the truth in the folder of its name beside the one that holds it, if there is one."""
    place = path.absolute().parent
    truth = place.with_name(f"{place.name}_gt") / path.name
    mask = existing(truth / "mask0nocc.png")
    masks = {} if mask is None else {"nonocc": mask}
    return replace(scene, disparity_left=existing(truth / "disp0GT.pfm"), masks=masks)
