"""Pairs of a calibrated rig made to correspond, and the search range that their frames share."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from depthcli.api.rigs import rectified_rig
from depthcli.core.cameras.rig import RectifiedRig
from depthcli.core.context import Latest
from depthcli.core.errors import ConfigError, InputError
from depthcli.core.frames import StereoPair
from depthcli.io.formats.calibrations import UNITS, write_geometry
from depthcli.io.formats.files import file_states
from depthcli.io.formats.images import pair_of, write_png
from depthcli.io.scenes import StereoScene
from depthcli.io.stereo_pairs import load_pair, load_views
from depthcli.methods.stereo.config import Calibration
from depthcli.methods.stereo.search_range import MatchedRange, matched_range
from depthcli.methods.stereo.view_matching import Points, match_views, row_error
from depthcli.run.json_csv import Row

_MAX_ROW_ERROR = 1.0  # median row error of a calibrated pair, pixels; with more a scene has a warning


def check_unit(unit: str) -> None:
    """Raise ConfigError where ``--unit`` names no unit of length that calibrations have."""
    if unit not in UNITS:
        raise ConfigError(f"--unit: must be {', '.join(UNITS)} (got {unit!r})")


def calibration_files(calibration: Calibration | None) -> dict[str, Path]:
    """Return role -> file of a calibration; None has none."""
    names = () if calibration is None else calibration.files
    return {f"calibration_{k}": Path(name) for k, name in enumerate(names)}


class RectifiedPair(NamedTuple):
    """A pair that a calibration made rectified, with facts and warnings for the report."""

    pair: StereoPair
    left: NDArray[np.generic]  # with its colors
    rig: RectifiedRig
    facts: Row
    warnings: list[str]

    def save(self, folder: Path) -> None:
        """Write the rectified left image and its calibration."""
        write_png(folder / "left.png", self.left)
        write_geometry(folder / "calib.txt", self.rig.geometry)


def rectified_pair(calibration: Calibration, scene: StereoScene, latest: Latest) -> RectifiedPair:
    """Return the rectified pair; rows are compared but in later frames of a sequence, which have the same cameras."""
    left, right = load_views(scene)
    rig = rectified_rig(calibration, left, right, latest)
    pair, view = _pair_of(rig, scene, left, right)
    facts, warnings = Row(), list[str]()
    if scene.is_first:
        points = match_views(grey8(left), grey8(right))
        facts = row_errors(points, rig.points(*points))
        warnings = calibration_warnings(facts)
    if scene.has_truth:
        warnings.append("the map belongs to the rectified image, but the ground truth does not: do not compare them")
    return RectifiedPair(pair, view, rig, facts, warnings)


def sequence_range(
    calibration: Calibration | None, frames: Sequence[StereoScene], latest: Latest
) -> MatchedRange | None:
    """Return the search range that frames of a sequence give together; None where too few pixels match in all.

    ``latest`` keeps it for the other frames of the sequence, until the files change. Frames in which too few
    pixels match, or which cannot be read, do not count. Without a calibration the frames are rectified.
    """
    files = {file for frame in frames for file in frame.input_files.values()}
    files |= set(calibration_files(calibration).values())
    key = calibration, tuple(frames), file_states(*sorted(files))
    return latest.get("range", key, lambda: _sequence_range(calibration, frames, latest))


def _sequence_range(
    calibration: Calibration | None, frames: Sequence[StereoScene], latest: Latest
) -> MatchedRange | None:
    found: MatchedRange | None = None
    for frame in frames:
        try:
            if calibration is None:
                pair = load_pair(frame)
            else:
                views = load_views(frame)
                pair, _ = _pair_of(rectified_rig(calibration, *views, latest), frame, *views)
            one = matched_range(pair)
        except InputError:  # where no frame has a range, every one is on its own
            continue
        found = one if found is None else found.union(one)
    return found


def _pair_of(
    rig: RectifiedRig, scene: StereoScene, left: NDArray[np.generic], right: NDArray[np.generic]
) -> tuple[StereoPair, NDArray[np.generic]]:
    """Return the rectified pair, and its left image with the colors that the scene's has."""
    views = rig.images(left, right)
    assert scene.right is not None  # it was loaded
    return pair_of(views[0], views[1], (scene.left, scene.right)), views[0]


def row_errors(before: tuple[Points, Points], after: tuple[Points, Points]) -> Row:
    """Return how far the rows of matched points are apart before and after they were moved."""
    one, other = (None if math.isnan(error := row_error(*points)) else round(error, 4) for points in (before, after))
    return {"matches": len(before[0]), "row_error_before": one, "row_error": other}


def calibration_warnings(rows: Row) -> list[str]:
    """Return a warning where the rows of a pair are still apart after its calibration has rectified it."""
    if (rows["row_error"] or 0) <= _MAX_ROW_ERROR:
        return []
    return [
        f"the rows of half of the {rows['matches']} matched key points are still more than {rows['row_error']:.1f} px "
        "apart; is it the calibration of these images?"
    ]


def grey8(image: NDArray[Any]) -> NDArray[np.uint8]:
    """Return any image as (H, W) uint8."""
    return StereoPair(image, image).grey8[0]
