"""Disparity maps that were made before: those of a run, and pairs with maps of other programs."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from depthcli.core.cameras.triangulation import PairGeometry
from depthcli.io.formats.disparity import lone_constant, read_disparity, read_plane
from depthcli.io.formats.files import shown, warn
from depthcli.io.scenes import Scene
from depthcli.io.scenes.stereo import StereoScene


@dataclass(frozen=True, kw_only=True)
class DisparityScene(Scene):
    """A disparity map that a run made, with the files that belong to it."""

    disparity: Path  # the map
    status: Path | None = None  # status of its pixels, or None
    confidence: dict[str, Path] = field(default_factory=dict)  # name -> map
    left: Path | None = None  # the image that the map describes, or None where it is missing
    calibration: Path | None = None  # calibration of the pair, or None
    cameras: tuple[int, int] = (2, 3)  # numbers of the left and right camera in a calibration of several
    geometry: PairGeometry | None = None  # what the data set of the pair says instead of a calibration, or None

    @property
    def input_files(self) -> dict[str, Path]:
        """Role -> file, for everything that a depth map can depend on."""
        known = {"disparity": self.disparity, "status": self.status, "left": self.left, "calibration": self.calibration}
        files = {role: file for role, file in known.items() if file is not None}
        return files | {f"confidence_{name}": file for name, file in self.confidence.items()}

    def load(self) -> NDArray[np.float32]:
        """Return the disparities, (H, W) float32, pixels, NaN = no value; InputError where they cannot be read."""
        self.check()
        return read_disparity(self.disparity)


@dataclass(frozen=True)
class GivenMap:
    """One file of a run."""

    run: str  # name of the run
    path: Path  # the file
    scale: float | None = None  # codes per pixel; None: as the file's kind says
    invalid: float | None = None  # value that stands for none; None: recognized

    def load(self) -> NDArray[np.float32]:
        """Return the map, (H, W) float32, pixels, NaN = no value; InputError where it cannot be read.

        Where nothing is said about what stands for no value, a constant at or below 0 that stands alone does, in
        maps of other programs; a warning says so.
        """
        values = read_disparity(self.path, self.scale)
        if self.invalid is not None:
            values[read_plane(self.path) == np.float32(self.invalid)] = np.nan
        elif not (self.path.parent / "record.json").is_file():  # runs of this program mark what has no value
            constant = lone_constant(values)
            if constant is not None:
                marked = values == np.float32(constant)
                values[marked] = np.nan
                warn(
                    f"{shown(self.path)}: {100 * np.mean(marked):.3g} % of the pixels are {constant:g}: taken as no "
                    "value (--invalid nan keeps them)"
                )
        return values


@dataclass(frozen=True, kw_only=True)
class MapsScene(StereoScene):
    """A pair with maps of its left view."""

    maps: tuple[GivenMap, ...] = ()  # the maps, in the order of the command line
    right_map: GivenMap | None = None  # map of the right view, or None
    absent: tuple[str, ...] = ()  # names of the runs that have no map of this scene

    @classmethod
    def of(cls, scene: StereoScene, *maps: Any) -> Self:
        """Return the scene with ``maps``, ``right_map``, ``absent``, and why it cannot be used, or an empty text."""
        own = {each.name: getattr(scene, each.name) for each in fields(StereoScene)}
        own["problem"] = scene.problem or maps[3]
        return cls(**own, maps=maps[0], right_map=maps[1], absent=maps[2])

    @property
    def input_files(self) -> dict[str, Path]:
        """The images and the maps."""
        files = {f"map_{k}_{one.run}": one.path for k, one in enumerate(self.maps)}
        more = {} if self.right_map is None else {"right_map": self.right_map.path}
        return super().input_files | files | more
