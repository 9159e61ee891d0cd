"""The labeled frames of NYU Depth v2 (Silberman et al., ECCV 2012)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.io.formats.hdf5 import length_hdf5, read_hdf5
from depthcli.io.layouts import Folder, Layout
from depthcli.io.scenes import Scene
from depthcli.io.scenes.rgbd import RgbdScene, RgbdTruth

_FILE = "nyu_depth_v2_labeled.mat"
_COLORS, _RAW, _FILLED = "images", "rawDepths", "depths"
_INTRINSICS = (518.8579, 519.4696, 325.5824, 253.7362)  # fx, fy, cx, cy of the color camera, by the set's toolbox


class NyuScene(RgbdScene):
    """One frame of the file, by its place there; the truth is the depth that the set's authors filled in."""

    def frame_size(self) -> tuple[int, int]:
        """Return (height, width)."""
        _, width, height = self._array(_COLORS, 3).shape
        return height, width

    def truth(self) -> RgbdTruth:
        """Return the filled depth."""
        self.check()
        return RgbdTruth(self._plane(_FILLED))

    def _color(self, path: Path) -> NDArray[np.uint8]:
        stored = self._array(_COLORS, 3)
        if stored.shape[0] != 3 or stored.dtype != np.uint8:
            raise InputError(f"{self.depth}: {_COLORS}: want colors of 8 bit, got {stored.dtype} of {stored.shape}")
        return np.ascontiguousarray(stored.transpose(2, 1, 0))

    def _depth(self, path: Path) -> NDArray[np.float32]:
        return self._plane(_RAW)

    def _plane(self, name: str) -> NDArray[np.float32]:
        depth = np.ascontiguousarray(self._array(name, 2).T, np.float32)
        return np.where(np.isfinite(depth) & (depth > 0), depth, np.float32(np.nan))

    def _array(self, name: str, axes: int) -> NDArray[Any]:
        """Entry of an array, whose axes are those of MATLAB in reverse."""
        stored = read_hdf5(self.depth, name, self.number)
        if stored.ndim != axes:
            raise InputError(f"{self.depth}: {name}: want entries of {axes} axes, got {stored.shape}")
        return stored


class NyuV2(Layout):
    """Frames of one file with the sensor's depth, in meters and registered to the color, and the depth filled in."""

    kind = NyuScene
    protocol = "depth"
    wants = f"`{_FILE}` (MATLAB 7.3: HDF5)"

    def scenes(self, folder: Folder) -> list[Scene]:
        if _FILE not in folder.names:
            return []
        file = folder.path / _FILE
        return [
            self.scene(
                folder,
                name=f"{folder.prefix}{number + 1:04d}",
                color=file,
                depth=file,
                depth_true=file,
                intrinsics=_INTRINSICS,
                number=number,
            )
            for number in range(length_hdf5(file, _COLORS))
        ]
