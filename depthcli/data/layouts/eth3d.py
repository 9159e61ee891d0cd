"""Two-view scenes of ETH3D."""

from __future__ import annotations

from depthcli.data.layouts import Folder
from depthcli.data.layouts.middlebury_v3 import MiddleburyV3


class Eth3d(MiddleburyV3):
    """As Middlebury v3, beside the files of the multi-view benchmark."""

    wants = "as `middlebury-v3`, with `cameras.txt`, `images.txt`"
    protocol = "eth3d"

    def fits(self, folder: Folder) -> bool:
        return folder.has("cameras.txt", "images.txt")
