"""Rectify pairs with a calibration, and find the common search range of a sequence's frames."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator

from depthcli.core.cameras.rig import RectifiedRig, Rig
from depthcli.core.cameras.triangulation import PairGeometry
from depthcli.core.config_file import load_config, option_settings
from depthcli.core.context import Latest
from depthcli.core.errors import InputError
from depthcli.core.frames import Image, StereoPair
from depthcli.core.method import ConfigModel
from depthcli.core.yaml_source import ConfigData
from depthcli.io.formats.calibrations import Reading, meters_of, read_rig, write_geometry
from depthcli.io.formats.files import collected_warnings, file_states, shown, warn
from depthcli.io.formats.images import pair_of, write_png
from depthcli.io.scenes import StereoScene
from depthcli.io.stereo_pairs import load_pair, load_views
from depthcli.methods.stereo.rectification import Points, match_views, row_error
from depthcli.methods.stereo.search_range import MatchedRange, SearchRange, matched_range
from depthcli.show.table import Row, number

_MAX_ROW_ERROR = 1.0  # largest median row error of a calibrated pair without a warning, pixels


class Calibration(ConfigModel):
    """A calibration of two cameras, with options for rectification; a file name may replace the whole section."""

    files: tuple[str, ...] = Field(
        min_length=1,
        max_length=2,
        description="OpenCV (YAML, XML), ROS camera_info (left, then right), Kalibr camchain, KITTI calib_cam_to_cam, "
        "ZED conf",
    )
    unit: str | None = Field(
        default=None,
        description="unit of the translation: m, cm, mm, or a length such as 24mm; null: the format's, usually m",
    )
    fisheye: bool = Field(default=False, description="whether an OpenCV calibration file describes fisheye lenses")
    cameras: tuple[Annotated[int, Field(ge=0, le=9)], Annotated[int, Field(ge=0, le=9)]] = Field(
        default=(2, 3), description="numbers of the left and right camera in a KITTI calibration file"
    )
    alpha: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="extent of rectified images: 0 keeps only pixels with image content, 1 keeps all pixels",
    )

    @model_validator(mode="before")
    @classmethod
    def _of_names(cls, data: Any) -> Any:
        data = [data] if isinstance(data, str) else data
        data = {"files": data} if isinstance(data, list) else data
        if isinstance(data, dict) and not data.get("files"):
            raise ValueError("there is no calibration; give --calibration FILE, too")
        return data

    @field_validator("unit")
    @classmethod
    def _is_a_length(cls, unit: str | None) -> str | None:
        if unit is not None:
            try:
                meters_of(unit)
            except InputError as error:
                raise ValueError(str(error)) from None
        return unit

    @field_validator("cameras", mode="before")
    @classmethod
    def _are_two(cls, cameras: Any) -> Any:
        if isinstance(cameras, list | tuple) and len(set(cameras)) != 2:
            raise ValueError("must be two numbers such as 2,3")
        return cameras

    @property
    def reading(self) -> Reading:
        """Options for reading the files."""
        return Reading(self.unit, self.fisheye, self.cameras, self.alpha)

    def rig(self, size: tuple[int, int] | None = None) -> Rig:
        """Return the two cameras, for images of ``size`` (width, height) if known. Raise InputError on failure."""
        return read_rig([Path(file) for file in self.files], self.reading, size)


class _Calibrated(ConfigModel):
    calibration: Calibration | None = None


def calibration_of(settings: Mapping[str, object]) -> Calibration | None:
    """Return the calibration in keys such as ``calibration.unit``, or None. Raise ConfigError for invalid values."""
    return load_config(_Calibrated, ConfigData("--calibration"), option_settings(settings)).calibration


def calibration_files(calibration: Calibration | None) -> dict[str, Path]:
    """Return role -> file of a calibration; empty for None."""
    names = () if calibration is None else calibration.files
    return {f"calibration_{k}": Path(name) for k, name in enumerate(names)}


def rectified_rig(calibration: Calibration, left: NDArray[Any], right: NDArray[Any], latest: Latest) -> RectifiedRig:
    """Return the rectification for images of these sizes. Raise InputError if the calibration does not fit them.

    ``latest`` keeps it, with its maps, for further images of the same sizes, until the files change.
    """
    sizes = (left.shape[1], left.shape[0]), (right.shape[1], right.shape[0])
    key = calibration, file_states(*map(Path, calibration.files)), sizes

    def read() -> tuple[RectifiedRig, list[str]]:
        with collected_warnings() as lines:
            rig = calibration.rig(sizes[0])
        lines += [f"{shown(calibration.files[0])}: {doubt}" for doubt in rig.doubts(*sizes)]
        return rig.rectified(*sizes, calibration.alpha), lines

    rig, lines = latest.get("rig", key, read)
    for line in lines:  # every pair gets the warnings, not only the first
        warn(line)
    return rig


@dataclass(frozen=True, eq=False)
class Rectified:
    """Two views rectified with a calibration, with facts and warnings for the report."""

    left: Image  # with its colors
    right: Image
    rig: RectifiedRig
    facts: Row = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    @classmethod
    def of(cls, calibration: Calibration, left: NDArray[Any], right: NDArray[Any], latest: Latest) -> Rectified:
        """Return the rectified views. Raise InputError if the calibration does not fit them."""
        rig = rectified_rig(calibration, left, right, latest)
        return cls(*rig.images(left, right)[:2], rig)

    def save(self, folder: Path) -> None:
        """Write the rectified left image and its calibration."""
        write_png(folder / "left.png", self.left)
        write_geometry(folder / "calib.txt", self.rig.geometry)


def rectified_scene(calibration: Calibration, scene: StereoScene, latest: Latest) -> Rectified:
    """Return the rectified views; rows are compared only in the first frame of a sequence."""
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
    """Return the common search range of a sequence's frames, or None if too few pixels match in every frame.

    ``latest`` keeps it for the other frames of the sequence, until the files change. Frames with too few matches and
    unreadable frames are ignored. Without a calibration, the frames must be rectified.
    """

    def pair_in(frame: StereoScene) -> StereoPair:
        if calibration is None:
            return load_pair(frame)
        rectified = Rectified.of(calibration, *load_views(frame), latest)
        return pair_of(rectified.left, rectified.right, (frame.left, frame.right or frame.left))

    def common_range() -> MatchedRange | None:
        common: MatchedRange | None = None
        for frame in frames:
            try:
                one = matched_range(pair_in(frame))
            except InputError:  # if no frame has a range, each frame reports its own problem
                continue
            common = one if common is None else common.union(one)
        return common

    files = {file for frame in frames for file in frame.input_files.values()}
    files |= set(calibration_files(calibration).values())
    return latest.get("range", (calibration, tuple(frames), file_states(*sorted(files))), common_range)


def metric_columns(geometry: PairGeometry, search: SearchRange | None, depth: float | None = None) -> Row:
    """Return focal length (pixels), baseline (meters) and the depth range (meters) of the disparities.

    There is no largest depth if the smallest disparity, plus the cameras' offset, is 0 or less. ``depth`` is a map's
    median depth.
    """
    row: Row = {"focal": geometry.left.fx, "baseline": geometry.baseline}
    ends = {} if search is None else {"min_depth": search.max_disparity, "max_depth": search.min_disparity}
    for name, disparity in ends.items():
        if (apart := disparity + geometry.offset) > 0:
            row[name] = float(f"{geometry.fb / apart:.6g}")
    return row if depth is None else row | {"median_depth": depth}


METRIC_COLUMNS = (
    number("baseline", "{:.4g} m"),
    number("min_depth", "{:.3g} m"),
    number("max_depth", "{:.3g} m"),
    number("median_depth", "{:.3g} m"),
)
"""Columns of the printed table."""


def row_errors(before: tuple[Points, Points], after: tuple[Points, Points]) -> Row:
    """Return the number of matched points and their row errors before and after rectification."""
    one, other = (None if math.isnan(error := row_error(*points)) else round(error, 4) for points in (before, after))
    return {"matches": len(before[0]), "row_error_before": one, "row_error": other}


def calibration_warnings(facts: Row) -> list[str]:
    """Return a warning if a pair has a large row error after rectification."""
    if (facts["row_error"] or 0) <= _MAX_ROW_ERROR:
        return []
    return [
        f"the rows of half of the {facts['matches']} matched key points are still more than {facts['row_error']:.1f} "
        "px apart; is it the calibration of these images?"
    ]


def grey8(image: NDArray[Any]) -> NDArray[np.uint8]:
    """Return any image as (H, W) uint8."""
    return StereoPair(image, image).grey8[0]
