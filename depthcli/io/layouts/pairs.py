"""Pairs in one folder, whose names say which view they are."""

from __future__ import annotations

from pathlib import Path

from depthcli.io.formats.images import IMAGE_SUFFIXES
from depthcli.io.layouts import Folder, Layout
from depthcli.io.layouts.views import pair_scenes
from depthcli.io.scenes import Scene
from depthcli.io.scenes.stereo import StereoScene

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
        if any(stem.endswith("_left.disp") for stem in images):  # of crestereo
            return []
        for ends, words in ((True, _ENDS), (False, _STARTS)):
            for pair in words:
                left, right = (_named(images, word, ends) for word in pair)
                if set(left) & set(right):
                    return pair_scenes(self, folder, left, right, {})
        return []


def _named(images: dict[str, Path], word: str, ends: bool) -> dict[str, Path]:
    """What is left of the stem -> file, of images whose names end or begin with the word."""
    files = {}
    for stem, file in images.items():
        name = stem.removesuffix(word) if ends else stem.removeprefix(word)
        if name not in ("", stem) and not name.startswith(_NO_IMAGES):
            files[name] = file
    return files
