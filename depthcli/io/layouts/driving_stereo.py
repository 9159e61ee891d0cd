"""DrivingStereo (Yang et al., CVPR 2019)."""

from __future__ import annotations

from pathlib import Path

from depthcli.io.layouts import Folder, Layout
from depthcli.io.layouts._trees import existing, files_below
from depthcli.io.scenes import Scene
from depthcli.io.scenes.stereo import StereoScene

_HALF_SCALE, _FULL_SCALE = 256.0, 128.0  # codes per pixel of the maps of half and of full size
_CALIBRATIONS = ("calib_train", "calib_test", "calib", ".")
_CAMERAS = (101, 103)  # numbers of the left and right one in the calibration


class DrivingStereo(Layout):
    """Frames of half or full size, in trees of left images, right images and disparities."""

    kind = StereoScene
    protocol = "kitti_2015"
    wants = (
        "`train-left-image`, `train-right-image`, `train-disparity-map` (or `test-...`, or `left-image-half-size`, "
        "`left-image-full-size` ... of a weather), `calib_train/half-image-calib/SEQUENCE.txt`"
    )

    def scenes(self, folder: Folder) -> list[Scene]:
        places = [name for name in sorted(folder.names) if _ends(name) and _other(name, "right-image") in folder.names]
        scenes: list[Scene] = []
        calibrations: dict[str, Path | None] = {}
        for left in (file for name in places for file in files_below(folder.path / name, (".jpg", ".png"))):
            where = left.relative_to(folder.path).as_posix()
            right = existing(folder.path / _other(where, "right-image"))
            truth = existing((folder.path / _other(where, "disparity-map")).with_suffix(".png"))
            full = "full-size" in where
            sequence = left.stem.partition("_")[0] if _ends(left.parent.name) else left.parent.name
            key = f"{'full' if full else 'half'}-image-calib/{sequence}.txt"
            if key not in calibrations:
                calibrations[key] = _calibration(folder.path, key)
            scale = _FULL_SCALE if full else _HALF_SCALE
            scenes.append(
                self.scene(
                    folder,
                    name=folder.prefix + "/".join([*filter(_ends, where.split("/")[:-1]), left.stem]),
                    problem="" if right else f"{left}: only one image of the pair, no right one",
                    left=left,
                    right=right,
                    disparity_left=truth,
                    disparity_scale=scale,
                    max_disparity=int(65535 / scale),  # the largest that a file can hold
                    calibration=calibrations[key],
                    cameras=_CAMERAS,
                )
            )
        return scenes


def _ends(name: str) -> bool:
    return name.removesuffix("-half-size").removesuffix("-full-size").endswith("left-image")


def _other(where: str, kind: str) -> str:
    """The path of the same frame among the files of another kind."""
    return where.replace("left-image", kind)


def _calibration(path: Path, key: str) -> Path | None:
    """The file of a sequence in the folder or the one above it."""
    places = (place / name / key for place in (path, path.parent) for name in _CALIBRATIONS)
    return next((file for file in places if existing(file)), None)
