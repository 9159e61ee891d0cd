"""Rectify both images of a pair with a calibration or with key points."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.core.cameras.rig import RectifiedRig
from depthcli.core.context import Context, Latest
from depthcli.core.errors import ConfigError, InputError
from depthcli.core.frames import StereoPair
from depthcli.io.formats.calibrations import write_geometry
from depthcli.io.formats.files import collected_warnings, write_text
from depthcli.io.formats.images import write_png
from depthcli.io.scenes import StereoScene
from depthcli.io.stereo_pairs import load_views, view_size
from depthcli.methods.stereo.rectification import Points, RectifyingHomographies, match_views, rectify_uncalibrated
from depthcli.methods.stereo.search_range import SearchRange, matched_range
from depthcli.problems.problem import SceneJob, Shown
from depthcli.problems.rectified import (
    METRIC_COLUMNS,
    Calibration,
    calibration_files,
    calibration_of,
    calibration_warnings,
    grey8,
    metric_columns,
    rectified_rig,
    row_errors,
    sequence_range,
)
from depthcli.run.job import Outcome
from depthcli.show.table import SIZE, Row, number, percent, share, size_of

_MIN_SPREAD = 1.0  # smallest disparity spread of an uncalibrated pair without a warning, pixels


@dataclass(frozen=True)
class Rectify(SceneJob[StereoScene]):
    """Rectify pairs, with key points alone if ``calibration`` is None."""

    command = "rectify"
    writes = ("left.png", "right.png", "calib.txt", "meta.json")
    shown = Shown(
        (
            SIZE,
            number("row_error_before", "{:.2f} px"),
            number("row_error", "{:.2f} px"),
            percent("overlap"),
            *METRIC_COLUMNS,
        )
    )

    config: Mapping[str, object]
    calibration: Calibration | None

    def files(self, scene: StereoScene) -> dict[str, Path]:
        """Return role -> file for the pair and the calibration."""
        return scene.input_files | calibration_files(self.calibration)

    def memory(self, scene: StereoScene) -> None:
        """Return None, since little more than the images is needed. Raise InputError for an unreadable calibration."""
        if self.calibration is not None:
            with collected_warnings():  # compute() repeats them
                self.calibration.rig(view_size(scene)[::-1] if scene.frame_number is None else None)

    def compute(self, scene: StereoScene, folder: Path, context: Context) -> Outcome:
        """Rectify the pair and find its search range.

        Frames of a calibrated video share a search range, and only the first frame's rows are compared.
        """
        clock = context.clock
        clock.start("load")
        left, right = load_views(scene)
        clock.start("key points")
        frames = scene.sequence if scene.frame_number is not None and self.calibration is not None else ()
        points = None if frames and not scene.is_first else match_views(grey8(left), grey8(right))
        clock.start("warp")
        rectified: RectifiedRig | RectifyingHomographies
        if self.calibration is not None:
            rectified = rectified_rig(self.calibration, left, right, context.latest)
        else:
            sizes = (left.shape[1], left.shape[0]), (right.shape[1], right.shape[0])
            if sizes[0] != sizes[1]:
                raise InputError(f"images of {sizes[0]} and {sizes[1]} pixels; without calibration they must agree")
            assert points is not None  # only calibrated videos have none
            rectified = rectify_uncalibrated(*points, sizes[0])
        *views, overlap = rectified.images(left, right)
        rows, warnings = Row(), list[str]()
        if points is not None:
            moved = rectified.points(*points)
            rows = row_errors(points, moved)
            warnings = calibration_warnings(rows) if self.calibration is not None else _flatness_warnings(*moved)
        clock.start("save")
        search: Row = {}
        try:
            search = self._search_range(frames, views, context.latest)
        except InputError as error:
            warnings.append(str(error))
        row: Row = {**size_of(views[0]), **rows, "overlap": share(overlap), **search}
        if isinstance(rectified, RectifiedRig):
            span = SearchRange(search["min_disparity"], search["max_disparity"]) if search else None
            row |= metric_columns(rectified.geometry, span)
            write_geometry(folder / "calib.txt", rectified.geometry, search.get("max_disparity"))
        for name, view in zip(("left", "right"), views, strict=True):
            write_png(folder / f"{name}.png", view)
        meta: Row = {"source": f"rectified by depthcli from {scene.name}", **search}
        if self.calibration is None:
            meta["uncalibrated"] = True  # makes ``depth`` raise an error
        write_text(folder / "meta.json", json.dumps(meta, indent=1) + "\n")
        return Outcome(row, clock.seconds, warnings)

    def _search_range(self, frames: tuple[StereoScene, ...], views: list[NDArray[Any]], latest: Latest) -> Row:
        """Return the disparity range that all frames suggest; if there are none, the range of the views."""
        alike = views[0].shape == views[1].shape and views[0].dtype == views[1].dtype
        pair = StereoPair(*(views if alike else map(grey8, views)))
        shared = sequence_range(self.calibration, frames, latest) if frames else None
        span = (shared or matched_range(pair)).suggested
        return {"min_disparity": span.min_disparity, "max_disparity": span.max_disparity}


def _flatness_warnings(left: Points, right: Points) -> list[str]:
    """Return a warning if the disparities of matched points hardly differ; the points are warped."""
    low, high = np.quantile(left[:, 0] - right[:, 0], (0.05, 0.95))
    if high - low >= _MIN_SPREAD:
        return []
    return [
        f"the disparities of most matched key points are within {high - low:.1f} px: the cameras are at one "
        "place, or see one flat thing; there is no depth to be found"
    ]


def rectifier(uncalibrated: bool, settings: Mapping[str, object]) -> Rectify:
    """Return the job for the options of a calibration. Raise ConfigError if they are invalid or contradictory."""
    read = calibration_of(settings)
    if uncalibrated == (read is not None):
        raise ConfigError("give --calibration FILE, or --uncalibrated")
    config = {"uncalibrated": uncalibrated, "unit": "m", "fisheye": False, "alpha": 0.0, "cameras": "2,3"}
    if read is not None:
        cameras = ",".join(map(str, read.cameras))
        config |= {"unit": read.unit or "m", "fisheye": read.fisheye, "alpha": read.alpha, "cameras": cameras}
    return Rectify(config, read)
