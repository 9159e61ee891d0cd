"""Pairs made to correspond: what ``rectify`` computes, and the commands that match pairs of a calibrated rig."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from depthcli.api.matching import file_states, read_rig, rectified_rig
from depthcli.commands._options import PairOptions, RectifyOptions, RunOptions
from depthcli.commands._scenes import find_scenes
from depthcli.core.cameras.rig import RectifiedRig
from depthcli.core.errors import ConfigError, InputError
from depthcli.core.frames import StereoPair
from depthcli.core.result import Clock
from depthcli.io.formats.calibrations import UNITS, write_geometry
from depthcli.io.formats.files import write_text
from depthcli.io.formats.images import pair_of, write_png
from depthcli.io.scenes import StereoScene
from depthcli.io.stereo_pairs import load_pair, load_views
from depthcli.methods.stereo.config import Calibration
from depthcli.methods.stereo.rectification import (
    Points,
    RectifyingHomographies,
    match_views,
    rectify_uncalibrated,
    row_error,
)
from depthcli.methods.stereo.search_range import KeyPointRange, range_of_key_points
from depthcli.run.batch import Batch, Outcome
from depthcli.run.console import SIZE, number, percent
from depthcli.run.json_csv import Row

_MAX_ROW_ERROR = 1.0  # median row error of a calibrated pair, pixels; with more a scene has a warning
_MIN_SPREAD = 1.0  # of the disparities of a pair without calibration, pixels; with less a scene has a warning


def prepare(pairs: PairOptions, how: RectifyOptions, run: RunOptions) -> tuple[Rectify, list[StereoScene]]:
    """Return the batch of ``rectify``, and the pairs that the options name."""
    files = tuple(path.absolute() for path in how.calibration or ())
    if how.uncalibrated == bool(files):
        raise ConfigError("give --calibration FILE, or --uncalibrated")
    if len(files) > 2:
        raise ConfigError("--calibration: at most two files belong together")
    check_unit(how.unit)
    first, _, second = how.cameras.partition(",")
    if not (first.isdigit() and second.isdigit() and len(first + second) == 2 and first != second):
        raise ConfigError(f"--cameras: must be two numbers such as 2,3 (got {how.cameras!r})")
    calibration = None
    if files:
        lens = {"unit": how.unit, "fisheye": how.fisheye, "alpha": how.alpha, "cameras": (int(first), int(second))}
        calibration = Calibration.model_validate({"files": [str(file) for file in files], **lens})
    config = {key: getattr(how, key) for key in ("uncalibrated", "unit", "fisheye", "alpha", "cameras")}
    return Rectify(config, calibration), find_scenes((StereoScene,), pairs, run)


def check_unit(unit: str) -> None:
    """Raise ConfigError where ``--unit`` names no unit of length that calibrations have."""
    if unit not in UNITS:
        raise ConfigError(f"--unit: must be {', '.join(UNITS)} (got {unit!r})")


@dataclass(frozen=True)
class Rectify(Batch[StereoScene]):
    """Rectifies pairs; ``calibration`` None: by their key points alone."""

    command = "rectify"
    columns = (
        SIZE,
        number("row_error_before", "{:.2f} px"),
        number("row_error", "{:.2f} px"),
        percent("overlap"),
    )

    config: Mapping[str, object]
    calibration: Calibration | None

    def files(self, scene: StereoScene) -> dict[str, Path]:
        """Return the files of the pair and of the calibration."""
        return scene.input_files | calibration_files(self.calibration)

    def memory(self, scene: StereoScene) -> None:
        """Return None, since it is little more than the images; InputError where the calibration cannot be read."""
        if self.calibration is not None:
            read_rig(self.calibration)

    def compute(self, scene: StereoScene, folder: Path, memory: int) -> Outcome:
        """Rectify the pair, and find its search range.

        Frames of a video that a calibration rectifies have one search range, and rows are compared in the first alone.
        """
        clock = Clock()
        clock.start("load")
        left, right = load_views(scene)
        clock.start("key points")
        frames = scene.sequence if scene.frame_number is not None and self.calibration is not None else ()
        points = None if frames and not scene.is_first else match_views(_grey8(left), _grey8(right))
        clock.start("warp")
        found: RectifiedRig | RectifyingHomographies
        if self.calibration is not None:
            found = rectified_rig(self.calibration, left, right)
        else:
            sizes = (left.shape[1], left.shape[0]), (right.shape[1], right.shape[0])
            if sizes[0] != sizes[1]:
                raise InputError(f"images of {sizes[0]} and {sizes[1]} pixels; without calibration they must agree")
            assert points is not None  # calibrated videos alone go without
            found = rectify_uncalibrated(*points, sizes[0])
        *views, overlap = found.images(left, right)
        rows, warnings = ({}, []) if points is None else _row_errors(points, found)
        clock.start("save")
        search: Row = {}
        try:
            search = self._search_range(frames, views)
        except InputError as error:
            warnings.append(str(error))
        facts: Row = {"width": found.size[0], "height": found.size[1], **rows}
        facts |= {"overlap": round(float(np.mean(overlap)), 6), **search}
        if isinstance(found, RectifiedRig):
            facts |= {"focal": found.geometry.left.fx, "baseline": found.geometry.baseline}
            write_geometry(folder / "calib.txt", found.geometry, search.get("max_disparity"))
        for name, view in zip(("left", "right"), views, strict=True):
            write_png(folder / f"{name}.png", view)
        meta = {"source": f"rectified by depthcli from {scene.name}", **search}
        write_text(folder / "meta.json", json.dumps(meta, indent=1) + "\n")
        return Outcome(facts, clock.seconds, warnings)

    def _search_range(self, frames: tuple[StereoScene, ...], views: list[NDArray[Any]]) -> Row:
        """Return the range of disparities that key points of the frames, or else of the views, suggest."""
        alike = views[0].shape == views[1].shape and views[0].dtype == views[1].dtype
        pair = StereoPair(*(views if alike else map(_grey8, views)))
        shared = sequence_range(self.calibration, frames) if frames else None
        span = (shared or range_of_key_points(pair)).suggested
        return {"min_disparity": span.min_disparity, "max_disparity": span.max_disparity}


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
        """Write the left image and the calibration that holds after rectification."""
        write_png(folder / "left.png", self.left)
        write_geometry(folder / "calib.txt", self.rig.geometry)


def rectified_pair(calibration: Calibration, scene: StereoScene) -> RectifiedPair:
    """Return the rectified pair; rows are compared but in later frames of a sequence, which have the same cameras."""
    left, right = load_views(scene)
    rig = rectified_rig(calibration, left, right)
    pair, view = _pair_of(rig, scene, left, right)
    points = match_views(_grey8(left), _grey8(right)) if scene.is_first else None
    facts, warnings = ({}, []) if points is None else _row_errors(points, rig)
    if scene.has_truth:
        warnings.append("the map is that of the rectified image, the scene's ground truth is not: do not compare them")
    return RectifiedPair(pair, view, rig, facts, warnings)


def sequence_range(calibration: Calibration | None, frames: Sequence[StereoScene]) -> KeyPointRange | None:
    """Return the search range that key points of frames of a sequence give together; None where too few match in all.

    The latest one is kept for the other frames of the sequence, until the files change. Frames in which too few key
    points match, or which cannot be read, do not count. Without a calibration the frames are rectified.
    """
    files = {file for frame in frames for file in frame.input_files.values()}
    files |= set(calibration_files(calibration).values())
    return _sequence_range(calibration, tuple(frames), file_states(*sorted(files)))


@lru_cache(maxsize=1)
def _sequence_range(
    calibration: Calibration | None, frames: tuple[StereoScene, ...], files: object
) -> KeyPointRange | None:
    found: KeyPointRange | None = None
    for frame in frames:
        try:
            if calibration is None:
                pair = load_pair(frame)
            else:
                views = load_views(frame)
                pair, _ = _pair_of(rectified_rig(calibration, *views), frame, *views)
            one = range_of_key_points(pair)
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


def _row_errors(points: tuple[Points, Points], rig: RectifiedRig | RectifyingHomographies) -> tuple[Row, list[str]]:
    """Return how far the rows of matched points are apart before and after, and warnings where that is too much."""
    moved = rig.points(*points)
    errors = (row_error(*points), row_error(*moved))
    before, after = (None if math.isnan(error) else round(error, 4) for error in errors)
    warnings = []
    if isinstance(rig, RectifiedRig) and (after or 0) > _MAX_ROW_ERROR:
        warnings.append(
            f"the rows of half of the {len(points[0])} matched key points are still more than {after:.1f} px apart; "
            "is it the calibration of these images?"
        )
    if not isinstance(rig, RectifiedRig) and len(points[0]):
        low, high = np.quantile(moved[0][:, 0] - moved[1][:, 0], (0.05, 0.95))
        if high - low < _MIN_SPREAD:
            warnings.append(
                f"the disparities of most matched key points lie within {high - low:.1f} px: the cameras stand at one "
                "place, or see one flat thing; there is no depth to be found"
            )
    return {"matches": len(points[0]), "row_error_before": before, "row_error": after}, warnings


def _grey8(image: NDArray[Any]) -> NDArray[np.uint8]:
    """Return any image as (H, W) uint8."""
    return StereoPair(image, image).grey8[0]
