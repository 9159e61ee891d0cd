"""Hypersim: rendered rooms (Roberts et al., ICCV 2021)."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.io.formats.hdf5 import read_hdf5
from depthcli.io.layouts import Folder, Layout
from depthcli.io.layouts._trees import existing, files_below
from depthcli.io.scenes import Scene
from depthcli.io.scenes.rgbd import RgbdScene

_GEOMETRY = "_geometry_hdf5"
_DEPTH = ".depth_meters.hdf5"
_WIDTH, _HEIGHT = 1024, 768
_FOCAL = _WIDTH / 2 / math.tan(math.pi / 6)  # pixels: the horizontal field of view is 60 degrees
_INTRINSICS = (_FOCAL, _FOCAL, (_WIDTH - 1) / 2, (_HEIGHT - 1) / 2)


class HypersimScene(RgbdScene):
    """A frame whose files hold distances from the camera's center in meters, which become depths along its axis."""

    def _depth(self, path: Path) -> NDArray[np.float32]:
        distance = read_hdf5(path, "dataset")
        if distance.ndim != 2:
            raise InputError(f"{path}: want distances of shape (H, W), got {distance.shape}")
        height, width = distance.shape
        focal = _FOCAL * width / _WIDTH
        x, y = np.arange(width) - (width - 1) / 2, np.arange(height) - (height - 1) / 2
        slant = np.sqrt(1 + (x[None, :] ** 2 + y[:, None] ** 2) / focal**2)
        depth = (distance.astype(np.float64) / slant).astype(np.float32)
        return np.where(np.isfinite(depth) & (depth > 0), depth, np.float32(np.nan))


class Hypersim(Layout):
    """Frames of the cameras of a scene, as tone-mapped previews; scenes with a tilted lens have other cameras."""

    kind = HypersimScene
    protocol = "depth"
    wants = (
        "`scene_cam_00_final_preview/frame.0000.tonemap.jpg`, "
        "`scene_cam_00_geometry_hdf5/frame.0000.depth_meters.hdf5`: the folder `images` of a scene"
    )

    def scenes(self, folder: Folder) -> list[Scene]:
        cameras = [name.removesuffix(_GEOMETRY) for name in sorted(folder.names) if name.endswith(_GEOMETRY)]
        scenes: list[Scene] = []
        for camera in cameras:
            for depth in files_below(folder.path / f"{camera}{_GEOMETRY}", (".hdf5",)):
                if not depth.name.endswith(_DEPTH):
                    continue
                frame = depth.name.removesuffix(_DEPTH)
                color = folder.path / f"{camera}_final_preview" / f"{frame}.tonemap.jpg"
                scenes.append(
                    self.scene(
                        folder,
                        name=f"{folder.prefix}{camera}_{frame}",
                        problem="" if existing(color) else f"{depth}: a frame without its color, {color}",
                        color=color,
                        depth=depth,
                        depth_true=depth,
                        intrinsics=_INTRINSICS,
                    )
                )
        return scenes
