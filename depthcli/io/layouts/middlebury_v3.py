"""Scenes of the third Middlebury evaluation and of the sets of 2014 and 2021."""

from __future__ import annotations

import re

from depthcli.core.errors import InputError
from depthcli.io.formats.files import naming, read_bytes
from depthcli.io.formats.images import IMAGE_SUFFIXES
from depthcli.io.formats.plain_text import key_values, numbers
from depthcli.io.layouts import Folder, Layout
from depthcli.io.scenes import Scene
from depthcli.io.scenes.stereo import MAX_DISPARITY, StereoScene


class MiddleburyV3(Layout):
    """``im0`` and ``im1`` with a ``calib.txt``."""

    kind = StereoScene
    wants = (
        "`im0`, `im1`, `calib.txt`, `disp0GT.pfm`, `mask0nocc.png`; of the sets of 2014 and 2021 `disp0.pfm`, "
        "`disp1.pfm`, by which pixels hidden in the right view are found"
    )
    protocol = "middlebury_v3"

    def fits(self, folder: Folder) -> bool:
        """True where the folder is of this layout and not of a related one."""
        return not folder.has("cameras.txt", "images.txt")

    def scenes(self, folder: Folder) -> list[Scene]:
        left, right = folder.one("im0", IMAGE_SUFFIXES), folder.one("im1", IMAGE_SUFFIXES)
        if left is None or not self.fits(folder):
            return []
        calib = _calibration(folder)
        top = calib.get("ndisp")
        if top is not None and top > MAX_DISPARITY:
            raise InputError(f"{folder.path / 'calib.txt'}: ndisp: want at most {MAX_DISPARITY} (got {top:g})")
        # ETH3D writes the image width where Middlebury writes the search range.
        if top is not None and (top < 1 or top >= calib.get("width", float("inf"))):
            top = None
        mask = folder.one("mask0nocc", IMAGE_SUFFIXES)
        return [
            self.scene(
                folder,
                problem="" if right else f"{folder.path}: only one image of the pair, no im1.*",
                left=left,
                right=right,
                disparity_left=folder.one("disp0GT", (".pfm",)) or folder.one("disp0", (".pfm",)),
                disparity_right=folder.one("disp1GT", (".pfm",)) or folder.one("disp1", (".pfm",)),
                masks={} if mask is None else {"nonocc": mask},
                max_disparity=None if top is None else int(top),
                round_disparity=calib.get("isint", 0) == 1,
                calibration=folder.one("calib", (".txt",)),
            )
        ]


def _calibration(folder: Folder) -> dict[str, float]:
    """The fields of a calib.txt that are a number."""
    if not folder.has("calib.txt"):
        return {}
    path = folder.path / "calib.txt"
    data = read_bytes(path)
    with naming(path):
        fields = key_values(data.decode("utf-8", "replace"))
        return {k: float(numbers(v, k)[0]) for k, v in fields.items() if re.fullmatch(r"[-+0-9.eE]+", v)}
