"""Folders with the images ``first.*`` and ``second.*`` of a pair."""

from __future__ import annotations

from depthcli.io.formats.images import IMAGE_SUFFIXES
from depthcli.io.formats.map_format import map_suffixes
from depthcli.io.scenes import Folder, Layout, Scene, StereoScene


class TwoFiles(Layout):
    """One folder a pair; ``first_truth.*`` holds its true disparities."""

    kind = StereoScene
    about = "`first.*`, `second.*`, `first_truth.*`"
    protocol = "eighth-pixel"

    def scenes(self, folder: Folder) -> list[Scene]:
        """Return the pair of a folder that holds both images."""
        left, right = folder.one("first", IMAGE_SUFFIXES), folder.one("second", IMAGE_SUFFIXES)
        if left is None or right is None:
            return []
        truth = folder.one("first_truth", map_suffixes())
        return [self.scene(folder, left=left, right=right, disparity_left=truth, max_disparity=12)]
