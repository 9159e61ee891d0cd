"""The stereo data of MPI Sintel (Butler et al., ECCV 2012)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.io.formats.images import read_image
from depthcli.io.layouts import Folder, Layout
from depthcli.io.layouts._trees import existing, files_below
from depthcli.io.scenes import Scene
from depthcli.io.scenes.stereo import StereoScene

_PASSES = ("clean", "final")
_PIXELS = (4.0, 2.0**-6, 2.0**-14)  # of a code of the red, green and blue channel


class SintelScene(StereoScene):
    """A frame whose disparities are packed into three channels of 8 bit."""

    def decode(self, file: Path, scale: float | None) -> NDArray[np.float32]:
        codes = read_image(file)
        if codes.ndim != 3 or codes.dtype != np.uint8:
            raise InputError(f"{file}: want disparities packed into three channels of 8 bit")
        disparity: NDArray[np.float32] = (codes @ np.array(_PIXELS)).astype(np.float32)
        disparity[~codes.any(axis=2)] = np.nan
        return disparity


class Sintel(Layout):
    """Frames of the clean and the final pass; pixels that leave the right image are not evaluated."""

    kind = SintelScene
    protocol = "middlebury_v2"
    wants = (
        "`clean_left/SEQUENCE/frame_0001.png`, `clean_right` (or `final_left`, `final_right`), `disparities`, "
        "`occlusions`, `outofframe`: the folder `training` of MPI Sintel's stereo data"
    )

    def scenes(self, folder: Folder) -> list[Scene]:
        scenes: list[Scene] = []
        for name in _PASSES:
            if not folder.has(f"{name}_left", f"{name}_right"):
                continue
            place, other = folder.path / f"{name}_left", folder.path / f"{name}_right"
            for left in files_below(place, (".png",)):
                where = left.relative_to(place)
                right = existing(other / where)
                scenes.append(
                    self.scene(
                        folder,
                        name=f"{folder.prefix}{name}/{'_'.join(where.with_suffix('').parts)}",
                        problem="" if right else f"{left}: only one image of the pair, no {other.name}/{where}",
                        left=left,
                        right=right,
                        disparity_left=existing(folder.path / "disparities" / where),
                        occluded=existing(folder.path / "occlusions" / where),
                        ignored=existing(folder.path / "outofframe" / where),
                    )
                )
        return scenes
