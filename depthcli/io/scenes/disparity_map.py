"""Disparity maps that a run has written."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from depthcli.io.scenes import Scene

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from depthcli.core.cameras.triangulation import PairGeometry


@dataclass(frozen=True, kw_only=True)
class DisparityScene(Scene):
    """A disparity map that a run made, with the files that belong to it.

    Attributes
    ----------
    disparity : the map
    status : status of its pixels, or None
    confidence : name -> map
    left : the image that the map describes, or None where it is missing
    calibration : calibration of the pair, or None
    cameras : numbers of the left and right camera in a calibration of several
    geometry : what the data set of the pair says instead of a calibration, or None
    """

    disparity: Path
    status: Path | None = None
    confidence: dict[str, Path] = field(default_factory=dict)
    left: Path | None = None
    calibration: Path | None = None
    cameras: tuple[int, int] = (2, 3)
    geometry: PairGeometry | None = None

    @property
    def input_files(self) -> dict[str, Path]:
        """Role -> file, for everything that a depth map can depend on."""
        known = {"disparity": self.disparity, "status": self.status, "left": self.left, "calibration": self.calibration}
        files = {role: file for role, file in known.items() if file is not None}
        return files | {f"confidence_{name}": file for name, file in self.confidence.items()}

    def load(self) -> NDArray[np.float32]:
        """Return the disparities, (H, W) float32, pixels, NaN = no value; InputError where they cannot be read."""
        from depthcli.io.formats.disparity import read_disparity

        self.check()
        return read_disparity(self.disparity)
