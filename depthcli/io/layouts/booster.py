"""Booster (Zama Ramirez et al., CVPR 2022): specular and transparent surfaces, 12 megapixels."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from depthcli.io.formats.images import read_grey
from depthcli.io.layouts import Folder, Layout
from depthcli.io.layouts._trees import existing
from depthcli.io.layouts.views import view_images
from depthcli.io.scenes import Scene
from depthcli.io.scenes.stereo import StereoScene

_CLASSES = range(4)  # of materials, from 0, the easiest, to 3, transparent or a mirror


@dataclass(frozen=True, kw_only=True)
class BoosterScene(StereoScene):
    """A pair with a map of the materials' classes; disparities of 0 are unknown.

    Attributes
    ----------
    materials : class of every pixel, from 0 to 3, or None
    """

    materials: Path | None = None

    def decode(self, file: Path, scale: float | None) -> NDArray[np.float32]:
        disparity = super().decode(file, scale)
        return np.where(disparity > 0, disparity, np.float32(np.nan))

    def read_masks(self) -> dict[str, tuple[Path, NDArray[np.bool_]]]:
        masks = super().read_masks()
        if self.materials is not None:
            classes = read_grey(self.materials)
            masks |= {f"class_{k}": (self.materials, classes == k) for k in _CLASSES}
        return masks


class Booster(Layout):
    """A folder per scene of the balanced split, whose images differ in their lights and share one truth."""

    kind = BoosterScene
    protocol = "booster"
    wants = (
        "`camera_00/im0.png`, `camera_02/im0.png`, `disp_00.npy`, `disp_02.npy`, `mask_00.png`, `mask_cat.png`, "
        "`calib_00-02.xml`: a folder of the balanced split"
    )

    def scenes(self, folder: Folder) -> list[Scene]:
        if "camera_00" not in folder.names or not ("camera_01" in folder.names or "camera_02" in folder.names):
            return []
        problem = ""
        if "camera_02" not in folder.names:
            problem = f"{folder.path}: an unbalanced pair, of two sizes; want camera_02, as in Booster's balanced split"
        lefts, rights = (view_images(folder.path / f"camera_0{k}", (".png",)) for k in (0, 2))
        mask = existing(folder.path / "mask_00.png")
        return [
            self.scene(
                folder,
                name=f"{folder.name}_{name}",
                problem=problem or ("" if name in rights else f"{left}: only one image of the pair, none in camera_02"),
                left=left,
                right=rights.get(name),
                disparity_left=existing(folder.path / "disp_00.npy"),
                disparity_right=existing(folder.path / "disp_02.npy"),
                masks={} if mask is None else {"nonocc": mask},
                materials=existing(folder.path / "mask_cat.png"),
                calibration=existing(folder.path / "calib_00-02.xml"),
            )
            for name, left in lefts.items()
        ]
