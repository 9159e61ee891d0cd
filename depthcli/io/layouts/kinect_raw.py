"""Raw recordings of a first-generation Kinect."""

from __future__ import annotations

from depthcli.io.formats.images import IMAGE_SUFFIXES
from depthcli.io.layouts import Folder, Layout
from depthcli.io.layouts.rgbd import frame
from depthcli.io.layouts.rgbd_sequence import numbered
from depthcli.io.scenes import Scene
from depthcli.io.scenes.rgbd import RgbdScene


class KinectRaw(Layout):
    """Codes 0..2047 in the depth camera's frame, which are triangulated and registered to the color camera."""

    kind = RgbdScene
    wants = (
        "`color.*` and `disparity*.*`, or `color_0000.*` and `disparity_0000.*`; `calib.json` with `dc_beta.npy` after "
        "Herrera et al., else a typical calibration"
    )

    def scenes(self, folder: Folder) -> list[Scene]:
        calibration = folder.path / "calib.json" if folder.has("calib.json") else None
        single = folder.starting("disparity", IMAGE_SUFFIXES)
        if not single:
            return []
        color = folder.one("color", IMAGE_SUFFIXES)
        if color is not None:
            depth = next(iter(single.values()))
            return [frame(self, folder, color, depth, raw=True, calibration=calibration)]
        colors, depths = (numbered(folder, start, IMAGE_SUFFIXES) for start in ("color_", "disparity_"))
        scenes: list[Scene] = []
        for number, depth in sorted(depths.items()):
            digits = depth.stem.rpartition("_")[2]
            problem = "" if number in colors else f"{depth}: a frame without its color"
            scenes.append(
                frame(self, folder, colors.get(number, depth), depth, name=folder.prefix + digits, problem=problem,
                      raw=True, calibration=calibration, sequence=folder.name, number=number)
            )  # fmt: skip
        return scenes
