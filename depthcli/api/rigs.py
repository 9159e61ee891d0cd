"""Rigs of two cameras, as calibrations tell of them: read, and kept with their maps for the next images."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from depthcli.core.cameras.rig import RectifiedRig, Rig
from depthcli.core.context import Latest
from depthcli.io.formats import calibrations
from depthcli.io.formats.files import file_states
from depthcli.methods.stereo.config import Calibration


def read_rig(calibration: Calibration) -> Rig:
    """Read the two cameras of a calibration; InputError where it cannot be read."""
    paths = [Path(file) for file in calibration.files]
    return calibrations.read_rig(paths, calibration.unit, calibration.fisheye, calibration.cameras)


def rectified_rig(calibration: Calibration, left: NDArray[Any], right: NDArray[Any], latest: Latest) -> RectifiedRig:
    """Return how images of these sizes are rectified; InputError where the calibration is not theirs.

    ``latest`` keeps it, with its maps, for the following images of the same sizes, until the files change.
    """
    sizes = (left.shape[1], left.shape[0]), (right.shape[1], right.shape[0])
    key = calibration, file_states(*map(Path, calibration.files)), sizes
    return latest.get("rig", key, lambda: read_rig(calibration).rectified(*sizes, calibration.alpha))
