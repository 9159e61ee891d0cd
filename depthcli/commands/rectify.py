"""Rectify image pairs, with or without a calibration.

For every scene the rectified pair is written, its calibration as calib.txt, and the search range that matched key
points suggest.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal, TypedDict

from depthcli.commands._flags import FLAGS
from depthcli.commands._old_batch import BatchCommand
from depthcli.commands._old_options import DRY_RUN, INPUT, LAYOUT, NAME, OUTPUT, RUN, SCENES
from depthcli.commands._rectified import UNIT, check_unit
from depthcli.commands._scenes import find_scenes
from depthcli.core.errors import ConfigError, InputError
from depthcli.core.option import Option
from depthcli.io.scenes.stereo import StereoScene
from depthcli.run.batch import Outcome
from depthcli.run.command import Values
from depthcli.run.console import SIZE, Column, Reporter, percent
from depthcli.run.json_csv import Row

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from depthcli.core.cameras.rig import RectifiedRig
    from depthcli.methods.stereo.config import Calibration
    from depthcli.methods.stereo.rectification import RectifyingHomographies


class RectifyOptions(TypedDict):
    """Options of a run of ``rectify``, as ``run.yaml`` holds them."""

    uncalibrated: bool
    unit: Literal["m", "cm", "mm"]
    fisheye: bool
    alpha: float
    cameras: str


class RectifyCommand(BatchCommand[RectifyOptions, StereoScene]):
    """``depthcli rectify --input DIR --calibration FILE --output DIR``."""

    results: ClassVar[tuple[str, ...]] = ("left.png", "right.png", "calib.txt", "meta.json")

    options = (
        INPUT,
        *(option for option in StereoScene.options if option.name in ("left", "right")),
        OUTPUT,
        NAME,
        LAYOUT,
        SCENES,
        Option("calibration", Path, "Calibration: OpenCV (YAML, XML), ROS camera_info (left, then right), Kalibr "
               "camchain or KITTI calib_cam_to_cam; repeatable.", "FILE", repeatable=True, group="Input"),
        Option("uncalibrated", bool, "Rectify by matched key points alone; depths stay unknown.", default=False),
        replace(UNIT, default="m"),
        Option("fisheye", bool, "The lenses of an OpenCV file are fisheye.", default=False, group="Input"),
        Option("cameras", str, "Numbers of the left and right camera in a KITTI file.", "L,R", default="2,3",
               group="Input"),
        Option("alpha", float, "0: keep only what both images show; 1: keep all of both.", "SHARE", default=0.0,
               min_value=0, max_value=1),
        *RUN,
        *FLAGS,
        DRY_RUN,
    )  # fmt: skip

    page = "how_to/rig_to_meters"
    examples = (
        "depthcli rectify --input photos --calibration stereo.yaml --output rectified",
        "depthcli rectify --left l.jpg --right r.jpg --uncalibrated --output pair",
    )

    def run(self, values: Values, reporter: Reporter) -> int:
        """Rectify every pair; return the exit code."""
        files = [str(path.absolute()) for path in values["calibration"] or ()]
        if values["uncalibrated"] == bool(files):
            raise ConfigError("give --calibration FILE, or --uncalibrated")
        if len(files) > 2:
            raise ConfigError("--calibration: at most two files belong together")
        check_unit(values["unit"])
        first, _, second = values["cameras"].partition(",")
        if not (first.isdigit() and second.isdigit() and len(first + second) == 2 and first != second):
            raise ConfigError(f"--cameras: must be two numbers such as 2,3 (got {values['cameras']!r})")
        config = RectifyOptions(
            uncalibrated=values["uncalibrated"], unit=values["unit"], fisheye=values["fisheye"],
            alpha=values["alpha"], cameras=values["cameras"],
        )  # fmt: skip
        scenes = find_scenes((StereoScene,), values, reporter)
        self._calibration = tuple(Path(file) for file in files)
        return self.run_on(config, scenes, values, reporter)

    _calibration: tuple[Path, ...] = ()

    def files(self, config: RectifyOptions, scene: StereoScene) -> dict[str, Path]:
        return scene.input_files | {f"calibration_{k}": file for k, file in enumerate(self._calibration)}

    def memory_of(self, config: RectifyOptions, scene: StereoScene) -> None:
        """Return None, since it is little more than the images; InputError where the calibration cannot be read."""
        if not config["uncalibrated"]:
            from depthcli.io.formats.calibrations import read_rig

            how = self._calibrated(config)
            read_rig(self._calibration, how.unit, how.fisheye, how.cameras)

    def columns(self) -> tuple[Column, ...]:
        """Return size, median row error before and after, and the share of the image that both cameras see."""

        def pixels(key: str) -> Column:
            return Column(key.replace("_", " "), lambda row: f"{row[key]:.2f} px" if row.get(key) is not None else "-")

        overlap = Column("overlap", percent("overlap"))
        return (SIZE, pixels("row_error_before"), pixels("row_error"), overlap)

    def compute(self, config: RectifyOptions, scene: StereoScene, folder: Path, memory: int) -> Outcome:
        """Rectify one pair.

        Frames of a video that a calibration rectifies have one search range, and rows are compared in the first alone.

        Raises
        ------
        InputError
            The images or the calibration cannot be used, or the rows still differ by more than a pixel.
        """
        import numpy as np

        from depthcli.commands import _rectified
        from depthcli.core.cameras.rig import RectifiedRig
        from depthcli.core.frames import StereoPair
        from depthcli.core.result import Clock
        from depthcli.io.formats.files import write_text
        from depthcli.methods.stereo.search_range import range_of_key_points

        clock = Clock()
        clock.start("load")
        left, right = scene.load_views()
        clock.start("key points")
        frames = scene.sequence if scene.frame_number is not None and not config["uncalibrated"] else ()
        points = None if frames and not scene.is_first else _rectified.match_rows(left, right)
        clock.start("warp")
        found = self._rectifier(config, points, left, right)
        views = found.images(left, right)
        rows, warnings = ({}, []) if points is None else _rectified.row_errors(points, found)
        clock.start("save")
        meta: Row = {"source": f"rectified by depthcli from {scene.name}"}
        facts: Row = {"width": found.size[0], "height": found.size[1], **rows}
        facts["overlap"] = round(float(np.mean(views[2])), 6)
        same = views[0].shape == views[1].shape and views[0].dtype == views[1].dtype
        try:
            alike = views[:2] if same else [_rectified.grey8(view) for view in views[:2]]
            shared = _rectified.sequence_range(self._calibrated(config), frames) if frames else None
            found_range = (shared or range_of_key_points(StereoPair(*alike))).suggested
            search = {"min_disparity": found_range.min_disparity, "max_disparity": found_range.max_disparity}
            meta |= search
            facts |= search
        except InputError as error:
            warnings.append(str(error))
        if isinstance(found, RectifiedRig):
            facts |= {"focal": found.geometry.left.fx, "baseline": found.geometry.baseline}
        _rectified.save_views(folder, {"left": views[0], "right": views[1]}, found, meta.get("max_disparity"))
        write_text(folder / "meta.json", json.dumps(meta, indent=1) + "\n")
        return Outcome(facts, clock.seconds, warnings)

    def _rectifier(
        self,
        config: RectifyOptions,
        points: tuple[NDArray[np.float64], NDArray[np.float64]] | None,
        left: NDArray[np.generic],
        right: NDArray[np.generic],
    ) -> RectifiedRig | RectifyingHomographies:
        from depthcli.api.matching import rectified_rig
        from depthcli.methods.stereo.rectification import rectify_uncalibrated

        if not config["uncalibrated"]:
            return rectified_rig(self._calibrated(config), left, right)
        sizes = (left.shape[1], left.shape[0]), (right.shape[1], right.shape[0])
        if sizes[0] != sizes[1]:
            raise InputError(f"images of {sizes[0]} and {sizes[1]} pixels; without calibration they must agree")
        assert points is not None  # calibrated videos alone go without
        return rectify_uncalibrated(*points, sizes[0])

    def _calibrated(self, config: RectifyOptions) -> Calibration:
        from depthcli.methods.stereo.config import Calibration

        first, _, second = config["cameras"].partition(",")
        files = tuple(str(file) for file in self._calibration)
        return Calibration(
            files=files, unit=config["unit"], fisheye=config["fisheye"], cameras=(int(first), int(second)),
            alpha=config["alpha"],
        )  # fmt: skip


COMMAND = RectifyCommand()
