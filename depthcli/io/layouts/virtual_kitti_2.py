"""Virtual KITTI 2 (Cabon et al., 2020)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from depthcli.core.cameras.camera import Intrinsics
from depthcli.core.cameras.triangulation import PairGeometry, disparity_of_depth
from depthcli.core.errors import InputError
from depthcli.io.formats.depth import read_codes
from depthcli.io.formats.files import naming, read_bytes
from depthcli.io.formats.plain_text import numbers
from depthcli.io.layouts import Folder, Layout
from depthcli.io.layouts._trees import existing, files_below
from depthcli.io.scenes import Scene
from depthcli.io.scenes.stereo import StereoScene

_BASELINE = 0.532725  # meters
_INTRINSICS = (725.0087, 725.0087, 620.5, 187.0)  # fx, fy, cx, cy of all sequences, as in their intrinsic.txt
_CODES_PER_METER = 100.0
_SKY = 65535  # code of what is farther than 655.35 m
_MAX_DISPARITY = 255  # as of the KITTI sets


class VirtualKittiScene(StereoScene):
    """A frame whose truth is the depth of either camera, in centimeters; where it is the sky, it is unknown."""

    def decode(self, file: Path, scale: float | None) -> NDArray[np.float32]:
        assert self.geometry is not None
        codes = read_codes(file)
        depth = np.where((codes == 0) | (codes == _SKY), np.nan, codes / _CODES_PER_METER)
        return disparity_of_depth(depth, self.geometry.fb)


class VirtualKitti2(Layout):
    """Sequences of the left (0) and the right camera (1)."""

    kind = VirtualKittiScene
    protocol = "kitti_2015"
    wants = (
        "`frames/rgb/Camera_0/rgb_00000.jpg`, `Camera_1`, `frames/depth/Camera_0/depth_00000.png`, `intrinsic.txt`: "
        "a folder such as `Scene01/clone`"
    )

    def scenes(self, folder: Folder) -> list[Scene]:
        if "frames" not in folder.names:
            return []
        frames = folder.path / "frames"
        lefts = files_below(frames / "rgb" / "Camera_0", (".jpg", ".png"))
        calibration = existing(folder.path / "intrinsic.txt")
        geometry = _geometry(calibration)
        scenes: list[Scene] = []
        for left in lefts:
            number = left.stem.partition("_")[2]
            right = existing(frames / "rgb" / "Camera_1" / left.name)
            depth = [existing(frames / "depth" / f"Camera_{k}" / f"depth_{number}.png") for k in (0, 1)]
            scenes.append(
                self.scene(
                    folder,
                    name=folder.prefix + number,
                    problem="" if right else f"{left}: only one image of the pair, no Camera_1/{left.name}",
                    left=left,
                    right=right,
                    disparity_left=depth[0],
                    disparity_right=depth[1],
                    max_disparity=_MAX_DISPARITY,
                    calibration=calibration,
                    geometry=geometry,
                )
            )
        return scenes


def _geometry(path: Path | None) -> PairGeometry:
    """The cameras by the first line of a table of frame, camera, fx, fy, cx and cy, if there is one."""
    if path is None:
        return PairGeometry(Intrinsics(*_INTRINSICS), _BASELINE)
    lines = read_bytes(path).decode("utf-8", "replace").splitlines()
    with naming(path):
        if len(lines) < 2:
            raise InputError("want a heading and lines of frame, camera, fx, fy, cx, cy")
        camera = numbers(lines[1], "the first line of numbers", (6,))[2:]
        return PairGeometry(Intrinsics(*camera.tolist()), _BASELINE)
