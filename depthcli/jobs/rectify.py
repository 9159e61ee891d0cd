"""Rectify image pairs by a calibration of the cameras, or without one: scenes that ``stereo`` and ``depth`` take.

Every scene gets the rectified pair, its calibration as calib.txt, and the search range that matched key points
suggest.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from depthcli.core.errors import ConfigError, InputError
from depthcli.core.option import Option
from depthcli.io.items.stereo import StereoItem
from depthcli.jobs._batch import DRY_RUN, HOW, INPUT, LAYOUT, NAME, OUTPUT, SCENES, BatchCommand, find_scenes

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from depthcli.batch.reporter import Reporter
    from depthcli.batch.runner import Outcome
    from depthcli.batch.tables import Column
    from depthcli.core.stereo_rig import RectifiedRig, StereoRig
    from depthcli.stereo.rectification import RectifyingHomographies

_DOUBTFUL = 1.0  # median row error of a calibrated pair above which a scene says so, pixels


class RectifyCommand(BatchCommand):
    """``depthcli rectify --input DIR --calibration FILE --output DIR``."""

    @property
    def options(self) -> tuple[Option, ...]:
        """The pairs, the cameras, and what the images shall show."""
        images = tuple(option for option in StereoItem.options if option.name in ("left", "right"))
        return (
            INPUT,
            *images,
            OUTPUT,
            NAME,
            LAYOUT,
            SCENES,
            Option("calibration", Path, "OpenCV (YAML, XML), ROS camera_info (left, then right), Kalibr camchain, "
                   "KITTI calib_cam_to_cam; repeatable.", "FILE", many=True),
            Option("uncalibrated", bool, "By matched key points alone; depths stay unknown.", default=False),
            Option("unit", str, "Unit of OpenCV's translation: m, cm or mm.", "UNIT", default="m"),
            Option("fisheye", bool, "The lenses of OpenCV's file are fisheye.", default=False),
            Option("cameras", str, "Numbers of the left and right camera in KITTI's file.", "L,R", default="2,3"),
            Option("alpha", float, "0: only what both images hold; 1: all that either holds.", "SHARE", default=0.0,
                   least=0, most=1),
            *HOW,
            DRY_RUN,
        )  # fmt: skip

    def run(self, values: Mapping[str, Any], reporter: Reporter) -> int:
        """Rectify every pair."""
        files = [str(path.absolute()) for path in values["calibration"] or ()]
        if values["uncalibrated"] == bool(files):
            raise ConfigError("want --calibration FILE, or --uncalibrated")
        if len(files) > 2:
            raise ConfigError("--calibration: at most two files belong together")
        if values["unit"] not in ("m", "cm", "mm"):
            raise ConfigError(f"--unit: want m, cm or mm (got {values['unit']!r})")
        first, _, second = values["cameras"].partition(",")
        if not (first.isdigit() and second.isdigit() and len(first + second) == 2 and first != second):
            raise ConfigError(f"--cameras: want two numbers such as 2,3 (got {values['cameras']!r})")
        config = {key: values[key] for key in ("uncalibrated", "unit", "fisheye", "alpha", "cameras")}
        items = find_scenes((StereoItem,), values, reporter)
        self._calibration = tuple(Path(file) for file in files)
        return self.run_on(config, items, values, reporter)

    _calibration: tuple[Path, ...] = ()

    def files(self, config: Any, item: StereoItem) -> dict[str, Path]:
        """The pair and the calibration."""
        return item.input_files | {f"calibration_{k}": file for k, file in enumerate(self._calibration)}

    def memory_of(self, config: Any, item: StereoItem) -> None:
        """No estimate: little more than the images themselves; InputError where the calibration cannot be read."""
        if not config["uncalibrated"]:
            self._rig(config)

    def columns(self) -> tuple[Column, ...]:
        """Size, median row error before and after, share of the image that both cameras see."""
        from depthcli.batch.tables import SIZE, Column, percent

        def pixels(key: str) -> Column:
            return Column(key.replace("_", " "), lambda row: f"{row[key]:.2f} px" if row.get(key) is not None else "-")

        overlap = Column("overlap", percent("overlap"))
        return (SIZE, pixels("row_error_before"), pixels("row_error"), overlap)

    def compute(self, config: Any, item: StereoItem, folder: Path, memory: int) -> Outcome:
        """Rectify one pair.

        Raises
        ------
        InputError
            The images or the calibration cannot be used, or the rows still differ by more than a pixel.
        """
        import numpy as np

        from depthcli.batch.runner import Outcome
        from depthcli.core.frames import StereoPair
        from depthcli.core.result import Clock
        from depthcli.core.stereo_rig import RectifiedRig
        from depthcli.io.atomic import write_text
        from depthcli.io.calibration import write_geometry
        from depthcli.io.images import write_png
        from depthcli.stereo.rectification import match_views, row_error
        from depthcli.stereo.search_range import range_of_key_points

        clock = Clock()
        left, right = item.load_views()
        clock.stop("load")
        points = match_views(_grey8(left), _grey8(right))
        clock.stop("key points")
        found = self._rectifier(config, points, left, right)
        views = found.images(left, right)
        moved = found.points(*points)
        clock.stop("warp")
        for name, view in zip(("left", "right"), views[:2], strict=True):
            write_png(folder / f"{name}.png", view)
        meta: dict[str, Any] = {"source": f"rectified by depthcli from {item.name}"}
        facts: dict[str, Any] = {"width": found.size[0], "height": found.size[1], "matches": len(points[0])}
        facts |= {"row_error_before": _rounded(row_error(*points)), "row_error": _rounded(row_error(*moved))}
        facts["overlap"] = round(float(np.mean(views[2])), 6)
        warnings = []
        same = views[0].shape == views[1].shape and views[0].dtype == views[1].dtype
        try:
            pair = StereoPair(views[0], views[1]) if same else StereoPair(_grey8(views[0]), _grey8(views[1]))
            search, _ = range_of_key_points(pair)
            meta |= {"min_disparity": min(search.low, 0), "max_disparity": max(search.top, 1)}
            facts |= {key: meta[key] for key in ("min_disparity", "max_disparity")}
        except InputError as error:
            warnings.append(str(error))
        if isinstance(found, RectifiedRig):
            geometry = found.geometry
            write_geometry(folder / "calib.txt", geometry, meta.get("max_disparity"))
            facts |= {"focal": geometry.left.fx, "baseline": geometry.baseline}
            if (facts["row_error"] or 0) > _DOUBTFUL:
                warnings.append(
                    f"the rows of half of the {len(points[0])} matched key points are still more than "
                    f"{facts['row_error']:.1f} px apart; is it the calibration of these images?"
                )
        write_text(folder / "meta.json", json.dumps(meta, indent=1) + "\n")
        clock.stop("save")
        return Outcome(facts, clock.seconds, warnings)

    def _rectifier(
        self, config: Any, points: tuple[NDArray[np.float64], NDArray[np.float64]], left: Any, right: Any
    ) -> RectifiedRig | RectifyingHomographies:
        from depthcli.stereo.rectification import rectify_uncalibrated

        sizes = (left.shape[1], left.shape[0]), (right.shape[1], right.shape[0])
        if config["uncalibrated"]:
            if sizes[0] != sizes[1]:
                raise InputError(f"images of {sizes[0]} and {sizes[1]} pixels; without calibration they must agree")
            return rectify_uncalibrated(*points, sizes[0])
        return self._rig(config).rectified(*sizes, config["alpha"])

    def _rig(self, config: Any) -> StereoRig:
        from depthcli.io.stereo_rig import read_stereo_rig

        first, _, second = config["cameras"].partition(",")
        return read_stereo_rig(self._calibration, config["unit"], config["fisheye"], (int(first), int(second)))


def _grey8(image: Any) -> NDArray[np.uint8]:
    from depthcli.core.frames import StereoPair

    return StereoPair(image, image).grey8[0]


def _rounded(value: float) -> float | None:
    import math

    return None if math.isnan(value) else round(value, 4)


COMMAND = RectifyCommand()
