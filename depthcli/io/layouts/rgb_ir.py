"""Our own layout of color, infrared and depth."""

from __future__ import annotations

from depthcli.io.formats.images import IMAGE_SUFFIXES
from depthcli.io.layouts import Folder, Layout
from depthcli.io.layouts.rgbd import frames_of
from depthcli.io.scenes import Scene
from depthcli.io.scenes.rgb_ir import RgbIrScene


class RgbIr(Layout):
    """As ``rgbd``, with an infrared image and the calibration of both cameras."""

    kind = RgbIrScene
    wants = (
        "as `rgbd`, with `ir.*` (8 or 16 bit) and `calib.json` or OpenCV's `calib.yml` (M1 D1 M2 D2 R T); calib.json "
        "has `color`, `infrared` (K, distortion, size), R and t, or `rectified`: true and `fb` (focal length x "
        "baseline, pixels x meters); where known `ir_noprojector.*`"
    )

    def scenes(self, folder: Folder) -> list[Scene]:
        infrared = folder.one("ir", IMAGE_SUFFIXES)
        if infrared is None:
            return []
        return frames_of(
            self,
            folder,
            calibration=folder.one("calib", (".json", ".yml", ".yaml")),
            infrared=infrared,
            infrared_plain=folder.one("ir_noprojector", IMAGE_SUFFIXES),
            max_disparity=folder.meta.whole("max_disparity", 1),
        )
