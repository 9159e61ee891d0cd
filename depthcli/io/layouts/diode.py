"""DIODE: dense depth of rooms and streets (Vasiljevic et al., 2019)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.io.formats.disparity import map_npy
from depthcli.io.layouts import Folder, Layout
from depthcli.io.layouts._trees import existing
from depthcli.io.scenes import Scene, check_same_size
from depthcli.io.scenes.rgbd import RgbdScene

_INTRINSICS = (886.81, 927.06, 512.0, 384.0)  # fx, fy, cx, cy of all images
_DEPTH = "_depth"


class DiodeScene(RgbdScene):
    """A frame whose depth is an array (H, W, 1) of meters with a mask (H, W) of the valid ones beside it."""

    def _depth(self, path: Path) -> NDArray[np.float32]:
        depth = np.asarray(map_npy(path, 3))
        if depth.shape[2] != 1:
            raise InputError(f"{path}: want depths of shape (H, W, 1), got {depth.shape}")
        plane = depth[..., 0].astype(np.float32)
        known = np.isfinite(plane) & (plane > 0)
        mask = existing(path.with_name(f"{path.stem}_mask.npy"))
        if mask is not None:
            valid = np.asarray(map_npy(mask, 2))
            check_same_size(mask, valid.shape, path, plane.shape)
            known &= valid > 0
        return np.where(known, plane, np.float32(np.nan))


class Diode(Layout):
    """Frames side by side, in a folder per scan."""

    kind = DiodeScene
    protocol = "depth"
    wants = "`NAME.png`, `NAME_depth.npy` (meters), `NAME_depth_mask.npy`: a folder such as `scene_00019/scan_00183`"

    def scenes(self, folder: Folder) -> list[Scene]:
        arrays = folder.starting("", (".npy",))
        scenes: list[Scene] = []
        for name in (stem.removesuffix(_DEPTH) for stem in arrays if stem.endswith(_DEPTH) and stem != _DEPTH):
            depth, color = arrays[name + _DEPTH], folder.one(name, (".png",))
            scenes.append(
                self.scene(
                    folder,
                    name=folder.prefix + name,
                    problem="" if color else f"{depth}: a frame without its color, {name}.png",
                    color=color or folder.path / f"{name}.png",
                    depth=depth,
                    depth_true=depth,
                    intrinsics=_INTRINSICS,
                )
            )
        return scenes
