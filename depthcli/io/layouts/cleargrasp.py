"""Transparent objects with true depth: samples of ClearGrasp (Sajjan et al., ICRA 2020) as plain images."""

from __future__ import annotations

from depthcli.io.layouts import Folder, Layout
from depthcli.io.scenes import Scene
from depthcli.io.scenes.rgbd import RgbdScene

_SUFFIXES = (".png",)
_COLOR = (".jpg", ".png")


class Cleargrasp(Layout):
    """A folder per scene: the sensor's depth with glass in place and with the same objects painted; or rendered scenes.

    A rendered scene has its true depth alone: the sensor is made not to see the objects.
    """

    kind = RgbdScene
    protocol = "depth"
    wants = (
        "`rgb_transparent.*`, `depth_sensor_mm.png`, `depth_opaque_gt_mm.png`, or `rgb.*`, `depth_gt_mm.png`; "
        "`mask_transparent.png`"
    )

    def scenes(self, folder: Folder) -> list[Scene]:
        mask = folder.one("mask_transparent", _SUFFIXES)
        real = folder.one("rgb_transparent", _COLOR)
        color = real or folder.one("rgb", _COLOR)
        truth = folder.one("depth_opaque_gt_mm" if real else "depth_gt_mm", _SUFFIXES)
        depth = folder.one("depth_sensor_mm", _SUFFIXES) if real else truth
        if color is None or mask is None or (depth is None and truth is None):
            return []
        return [
            self.scene(
                folder,
                problem="" if depth else f"{folder.path}: no depth_sensor_mm.png",
                color=color,
                depth=depth or folder.path / "depth_sensor_mm.png",
                depth_true=truth,
                masks={"transparent": mask},
                hidden=None if real else mask,
            )
        ]
