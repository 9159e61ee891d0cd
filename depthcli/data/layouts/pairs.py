"""Pairs in one folder, told apart by a word of their names."""

from __future__ import annotations

from pathlib import Path

from depthcli.data.formats.images import IMAGE_SUFFIXES
from depthcli.data.layouts import Folder, Layout
from depthcli.data.layouts.views import pair_scenes
from depthcli.data.scenes import Scene
from depthcli.data.scenes.stereo import StereoScene

_ENDS = (("_L", "_R"), ("_l", "_r"), ("_left", "_right"), ("-left", "-right"), ("_Left", "_Right"))
_STARTS = (("left_", "right_"), ("left-", "right-"), ("L_", "R_"), ("l_", "r_"), ("Left_", "Right_"))
# What our own scenes and runs hold beside the images.
_NO_IMAGES = ("disp", "mask", "confidence")


class Pairs(Layout):
    """Many pairs side by side: ``0001_L.png`` and ``0001_R.png``."""

    kind = StereoScene
    wants = (
        "`NAME_L.*`/`NAME_R.*`, `NAME_left.*`/`NAME_right.*` or `left_NAME.*`/`right_NAME.*`; where known `calib.txt` "
        "and `meta.json` of all pairs"
    )

    def scenes(self, folder: Folder) -> list[Scene]:
        if folder.one("left", IMAGE_SUFFIXES) or folder.one("right", IMAGE_SUFFIXES):  # of scenes
            return []
        images = folder.starting("", IMAGE_SUFFIXES)
        for left, right, ends in (*((a, b, True) for a, b in _ENDS), *((a, b, False) for a, b in _STARTS)):
            sides: list[dict[str, Path]] = []
            for word in (left, right):
                cut = (
                    (lambda stem, w=word: stem.removesuffix(w)) if ends else (lambda stem, w=word: stem.removeprefix(w))
                )
                sides.append({
                    cut(stem): file
                    for stem, file in images.items()
                    if cut(stem) not in ("", stem) and not cut(stem).startswith(_NO_IMAGES)
                })  # fmt: skip
            if set(sides[0]) & set(sides[1]):
                return pair_scenes(folder, self.name, sides[0], sides[1])
        return []
