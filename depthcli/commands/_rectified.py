"""Pairs made to correspond: what ``rectify`` computes, and the commands that match pairs of a calibrated rig."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from depthcli.api.matching import file_states, read_rig, rectified_rig
from depthcli.commands._batch import run_batch
from depthcli.commands._options import PairOptions, RectifyOptions, RunOptions
from depthcli.commands._scenes import find_scenes
from depthcli.core.cameras.rig import RectifiedRig
from depthcli.core.errors import ConfigError, InputError
from depthcli.core.frames import StereoPair
from depthcli.core.result import Clock
from depthcli.io.formats.calibrations import UNITS, write_geometry
from depthcli.io.formats.files import write_text
from depthcli.io.formats.images import pair_of, write_png
from depthcli.io.scenes.stereo import StereoScene
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
from depthcli.run.console import SIZE, Column, percent
from depthcli.run.json_csv import Row

_MAX_ROW_ERROR = 1.0  # median row error of a calibrated pair, pixels; with more a scene has a warning
_MIN_SPREAD = 1.0  # of the disparities of a pair without calibration, pixels; with less a scene has a warning


class RectifyConfig(TypedDict):
    """Options of a run of ``rectify``, as ``run.yaml`` holds them."""

    uncalibrated: bool
    unit: str
    fisheye: bool
    alpha: float
    cameras: str


def rectify_pairs(pairs: PairOptions, how: RectifyOptions, run: RunOptions) -> int:
    """Rectify every pair that the options name; return the exit code."""
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
    scenes = find_scenes((StereoScene,), pairs, run)
    compute = _Rectify(calibration)
    config = RectifyConfig(
        uncalibrated=how.uncalibrated, unit=how.unit, fisheye=how.fisheye, alpha=how.alpha, cameras=how.cameras
    )
    columns = (SIZE, _pixels("row_error_before"), _pixels("row_error"), Column("overlap", percent("overlap")))
    batch = Batch(
        command="rectify", config=config, compute=compute, columns=columns, files=compute.files, memory=compute.memory
    )
    return run_batch(batch, scenes, run, pairs)


def check_unit(unit: str) -> None:
    """Raise ConfigError where ``--unit`` names no unit of length that calibrations have."""
    if unit not in UNITS:
        raise ConfigError(f"--unit: must be {', '.join(UNITS)} (got {unit!r})")


def _pixels(key: str) -> Column:
    return Column(key.replace("_", " "), lambda row: f"{row[key]:.2f} px" if row.get(key) is not None else "-")


@dataclass(frozen=True)
class _Rectify:
    """Rectifies one pair; ``calibration`` None: by its key points alone."""

    calibration: Calibration | None

    def files(self, scene: StereoScene) -> dict[str, Path]:
        names = () if self.calibration is None else self.calibration.files
        return scene.input_files | {f"calibration_{k}": Path(name) for k, name in enumerate(names)}

    def memory(self, scene: StereoScene) -> None:
        """Return None, since it is little more than the images; InputError where the calibration cannot be read."""
        if self.calibration is not None:
            read_rig(self.calibration)

    def __call__(self, scene: StereoScene, folder: Path, memory: int) -> Outcome:
        """Rectify the pair, and find its search range.

        Frames of a video that a calibration rectifies have one search range, and rows are compared in the first alone.
        """
        clock = Clock()
        clock.start("load")
        left, right = scene.load_views()
        clock.start("key points")
        frames = scene.sequence if scene.frame_number is not None and self.calibration is not None else ()
        points = None if frames and not scene.is_first else match_rows(left, right)
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
        views = found.images(left, right)
        rows, warnings = ({}, []) if points is None else row_errors(points, found)
        clock.start("save")
        meta: Row = {"source": f"rectified by depthcli from {scene.name}"}
        facts: Row = {"width": found.size[0], "height": found.size[1], **rows}
        facts["overlap"] = round(float(np.mean(views[2])), 6)
        same = views[0].shape == views[1].shape and views[0].dtype == views[1].dtype
        try:
            alike = views[:2] if same else [_grey8(view) for view in views[:2]]
            shared = sequence_range(self.calibration, frames) if frames else None
            found_range = (shared or range_of_key_points(StereoPair(*alike))).suggested
            search = {"min_disparity": found_range.min_disparity, "max_disparity": found_range.max_disparity}
            meta |= search
            facts |= search
        except InputError as error:
            warnings.append(str(error))
        if isinstance(found, RectifiedRig):
            facts |= {"focal": found.geometry.left.fx, "baseline": found.geometry.baseline}
        _save_views(folder, {"left": views[0], "right": views[1]}, found, meta.get("max_disparity"))
        write_text(folder / "meta.json", json.dumps(meta, indent=1) + "\n")
        return Outcome(facts, clock.seconds, warnings)


def rectified_pair(
    calibration: Calibration, scene: StereoScene, folder: Path
) -> tuple[StereoPair, Callable[[], None], Row, list[str]]:
    """Return the rectified pair, what writes its left image and calibration, facts for the report, and warnings.

    Rows are compared in single pairs and the first frames of sequences: the others have the same cameras.
    """
    left, right = scene.load_views()
    found = rectified_rig(calibration, left, right)
    pair, view = _pair_of(found, scene, left, right)
    facts, warnings = row_errors(match_rows(left, right), found) if scene.is_first else ({}, [])
    if scene.has_truth:
        warnings.append("the map is that of the rectified image, the scene's ground truth is not: do not compare them")
    return pair, partial(_save_views, folder, {"left": view}, found), facts, warnings


def sequence_range(calibration: Calibration | None, frames: Sequence[StereoScene]) -> KeyPointRange | None:
    """Return the search range that key points of frames of a sequence give together; None where too few match in all.

    The latest one is kept for the other frames of the sequence, until the files change. Frames in which too few key
    points match, or which cannot be read, do not count. Without a calibration the frames are rectified.
    """
    files = {file for frame in frames for file in frame.input_files.values()}
    if calibration is not None:
        files |= {Path(file) for file in calibration.files}
    return _sequence_range(calibration, tuple(frames), file_states(*sorted(files)))


@lru_cache(maxsize=1)
def _sequence_range(
    calibration: Calibration | None, frames: tuple[StereoScene, ...], files: object
) -> KeyPointRange | None:
    found: KeyPointRange | None = None
    for frame in frames:
        try:
            if calibration is None:
                pair = frame.load()
            else:
                left, right = frame.load_views()
                pair = _pair_of(rectified_rig(calibration, left, right), frame, left, right)[0]
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


def _save_views(
    folder: Path,
    views: Mapping[str, NDArray[np.generic]],
    rig: RectifiedRig | RectifyingHomographies,
    max_disparity: int | None = None,
) -> None:
    """Write each view as ``<name>.png`` and, where ``rig`` has metric depth, ``calib.txt`` with the search range."""
    for name, view in views.items():
        write_png(folder / f"{name}.png", view)
    if isinstance(rig, RectifiedRig):
        write_geometry(folder / "calib.txt", rig.geometry, max_disparity)


def match_rows(left: NDArray[np.generic], right: NDArray[np.generic]) -> tuple[Points, Points]:
    """Return matched key points of the images as they were taken."""
    return match_views(_grey8(left), _grey8(right))


def row_errors(points: tuple[Points, Points], rig: RectifiedRig | RectifyingHomographies) -> tuple[Row, list[str]]:
    """Return how far the rows of matched points are apart before and after, and warnings where that is too much."""
    moved = rig.points(*points)
    after = _rounded(row_error(*moved))
    facts = {"matches": len(points[0]), "row_error_before": _rounded(row_error(*points)), "row_error": after}
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
    return facts, warnings


def _grey8(image: NDArray[Any]) -> NDArray[np.uint8]:
    """Return any image as (H, W) uint8."""
    return StereoPair(image, image).grey8[0]


def _rounded(value: float) -> float | None:
    return None if math.isnan(value) else round(value, 4)
