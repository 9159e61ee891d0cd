"""Spring (Mehl et al., CVPR 2023)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from depthcli.core.cameras.camera import Intrinsics
from depthcli.core.cameras.triangulation import PairGeometry
from depthcli.core.errors import InputError
from depthcli.io.formats.files import naming, read_bytes
from depthcli.io.formats.hdf5 import read_hdf5
from depthcli.io.formats.plain_text import numbers
from depthcli.io.layouts import Folder, Layout
from depthcli.io.layouts._trees import existing, files_below
from depthcli.io.scenes import Scene
from depthcli.io.scenes.stereo import StereoScene, StereoTruth

_BASELINE = 0.065  # meters


class SpringScene(StereoScene):
    """A frame with disparities at twice its resolution, in pixels of the image; 0 is infinitely far, NaN unknown."""

    def decode(self, file: Path, scale: float | None) -> NDArray[np.float32]:
        disparity = read_hdf5(file, "disparity")
        if disparity.ndim != 2 or any(side % 2 for side in disparity.shape):
            raise InputError(f"{file}: want disparities at twice the resolution of the images, got {disparity.shape}")
        return np.where(np.isfinite(disparity), disparity, np.nan).astype(np.float32)

    def truth(self) -> StereoTruth:
        """Return every second disparity of every second row, as the set's reader does, and all of them as ``finer``."""
        stored = super().truth()
        right = None if stored.right is None else stored.right[::2, ::2]
        return replace(stored, disparity=stored.disparity[::2, ::2], right=right, finer=stored.disparity)


class Spring(Layout):
    """A folder per sequence; the focal length of its frames may change."""

    kind = SpringScene
    protocol = "spring"
    wants = (
        "`frame_left/frame_left_0001.png`, `frame_right`, `disp1_left/disp1_left_0001.dsp5` (HDF5), "
        "`cam_data/intrinsics.txt`: a folder such as `train/0001`"
    )

    def scenes(self, folder: Folder) -> list[Scene]:
        if not folder.has("frame_left", "frame_right"):
            return []
        table = existing(folder.path / "cam_data" / "intrinsics.txt") or existing(folder.path / "intrinsics.txt")
        lines = [] if table is None else read_bytes(table).decode("utf-8", "replace").splitlines()
        scenes: list[Scene] = []
        for left in files_below(folder.path / "frame_left", (".png",)):
            number = left.stem.rpartition("_")[2]
            right = existing(folder.path / "frame_right" / f"frame_right_{number}.png")
            truths = [existing(folder.path / f"disp1_{k}" / f"disp1_{k}_{number}.dsp5") for k in ("left", "right")]
            scenes.append(
                self.scene(
                    folder,
                    name=f"{folder.name}_{number}",
                    problem="" if right else f"{left}: only one image of the pair, no frame_right_{number}.png",
                    left=left,
                    right=right,
                    disparity_left=truths[0],
                    disparity_right=truths[1],
                    calibration=table,
                    geometry=None if table is None else _geometry(table, lines, number),
                )
            )
        return scenes


def _geometry(table: Path, lines: list[str], number: str) -> PairGeometry:
    """The cameras of a frame, whose number, from 1, is that of its line with fx, fy, cx and cy."""
    with naming(table):
        if not number.isdigit() or not 1 <= int(number) <= len(lines):
            raise InputError(f"no line for the frame {number}")
        camera = numbers(lines[int(number) - 1], f"line {int(number)}", (4,))
        return PairGeometry(Intrinsics(*camera.tolist()), _BASELINE)
