"""Pairs that a calibration rectifies, and the search range that the frames of a sequence share."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from depthcli.core.cameras.rig import RectifiedRig, Rig
from depthcli.core.context import Latest
from depthcli.core.errors import ConfigError, InputError
from depthcli.core.frames import Image, StereoPair
from depthcli.core.method import ConfigModel
from depthcli.io.formats import calibrations
from depthcli.io.formats.calibrations import UNITS, write_geometry
from depthcli.io.formats.files import file_states
from depthcli.io.formats.images import pair_of, write_png
from depthcli.io.scenes import StereoScene
from depthcli.io.stereo_pairs import load_pair, load_views
from depthcli.methods.stereo.search_range import MatchedRange, matched_range
from depthcli.methods.stereo.view_matching import Points, match_views, row_error
from depthcli.run.json_csv import Row

_MAX_ROW_ERROR = 1.0  # median row error of a calibrated pair, pixels; with more a scene has a warning


class Calibration(ConfigModel):
    """A calibration of two cameras and how images are rectified by it; a file name may replace the whole section."""

    files: tuple[str, ...] = Field(
        min_length=1,
        max_length=2,
        description="OpenCV (YAML, XML), ROS camera_info (left, then right), Kalibr camchain or KITTI calib_cam_to_cam",
    )
    unit: Literal["m", "cm", "mm"] = Field(
        default="m", description="unit of the translation in an OpenCV calibration file"
    )
    fisheye: bool = Field(default=False, description="whether an OpenCV calibration file describes fisheye lenses")
    cameras: tuple[Annotated[int, Field(ge=0, le=9)], Annotated[int, Field(ge=0, le=9)]] = Field(
        default=(2, 3), description="numbers of the left and right camera in a KITTI calibration file"
    )
    alpha: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="extent of rectified images, from 0: only what both hold, to 1: all that either holds",
    )

    @model_validator(mode="before")
    @classmethod
    def _of_names(cls, data: Any) -> Any:
        if isinstance(data, str):
            return {"files": [data]}
        return {"files": data} if isinstance(data, list) else data

    def rig(self) -> Rig:
        """Read the two cameras; InputError where they cannot be read."""
        return calibrations.read_rig([Path(file) for file in self.files], self.unit, self.fisheye, self.cameras)


def check_unit(unit: str) -> None:
    """Raise ConfigError where ``--unit`` names no unit of length that calibrations have."""
    if unit not in UNITS:
        raise ConfigError(f"--unit: must be {', '.join(UNITS)} (got {unit!r})")


def calibration_files(calibration: Calibration | None) -> dict[str, Path]:
    """Return role -> file of a calibration; None has none."""
    names = () if calibration is None else calibration.files
    return {f"calibration_{k}": Path(name) for k, name in enumerate(names)}


def rectified_rig(calibration: Calibration, left: NDArray[Any], right: NDArray[Any], latest: Latest) -> RectifiedRig:
    """Return how images of these sizes are rectified; InputError where the calibration is not theirs.

    ``latest`` keeps it, with its maps, for the following images of the same sizes, until the files change.
    """
    sizes = (left.shape[1], left.shape[0]), (right.shape[1], right.shape[0])
    key = calibration, file_states(*map(Path, calibration.files)), sizes
    return latest.get("rig", key, lambda: calibration.rig().rectified(*sizes, calibration.alpha))


@dataclass(frozen=True, eq=False)
class Rectified:
    """Two views that a calibration rectified, with facts and warnings for the report."""

    left: Image  # with its colors
    right: Image
    rig: RectifiedRig
    facts: Row = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    @classmethod
    def of(cls, calibration: Calibration, left: NDArray[Any], right: NDArray[Any], latest: Latest) -> Rectified:
        """Return the views rectified; InputError where the calibration is not theirs."""
        rig = rectified_rig(calibration, left, right, latest)
        return cls(*rig.images(left, right)[:2], rig)

    def save(self, folder: Path) -> None:
        """Write the rectified left image and its calibration."""
        write_png(folder / "left.png", self.left)
        write_geometry(folder / "calib.txt", self.rig.geometry)


def rectified_scene(calibration: Calibration, scene: StereoScene, latest: Latest) -> Rectified:
    """Return the rectified views; rows are compared but in later frames of a sequence, which have the same cameras."""
    views = load_views(scene)
    rectified = Rectified.of(calibration, *views, latest)
    facts, warnings = Row(), list[str]()
    if scene.is_first:
        points = match_views(*map(grey8, views))
        facts = row_errors(points, rectified.rig.points(*points))
        warnings = calibration_warnings(facts)
    if scene.has_truth:
        warnings.append("the map belongs to the rectified image, but the ground truth does not: do not compare them")
    return Rectified(rectified.left, rectified.right, rectified.rig, facts, tuple(warnings))


def sequence_range(
    calibration: Calibration | None, frames: Sequence[StereoScene], latest: Latest
) -> MatchedRange | None:
    """Return the search range that frames of a sequence give together; None where too few pixels match in all.

    ``latest`` keeps it for the other frames of the sequence, until the files change. Frames in which too few
    pixels match, or which cannot be read, do not count. Without a calibration the frames are rectified.
    """

    def pair_in(frame: StereoScene) -> StereoPair:
        if calibration is None:
            return load_pair(frame)
        rectified = Rectified.of(calibration, *load_views(frame), latest)
        return pair_of(rectified.left, rectified.right, (frame.left, frame.right or frame.left))

    def union() -> MatchedRange | None:
        union: MatchedRange | None = None
        for frame in frames:
            try:
                one = matched_range(pair_in(frame))
            except InputError:  # where no frame has a range, every one is on its own
                continue
            union = one if union is None else union.union(one)
        return union

    files = {file for frame in frames for file in frame.input_files.values()}
    files |= set(calibration_files(calibration).values())
    return latest.get("range", (calibration, tuple(frames), file_states(*sorted(files))), union)


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
