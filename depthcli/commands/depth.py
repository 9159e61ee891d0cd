"""Turn disparity maps into metric depth and point clouds.

The calibration lies beside the images that the run was made from (``calib.txt`` of Middlebury, ETH3D and of
``rectify``, KITTI's files), or is given by options.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, TypedDict

from depthcli.commands._clouds import check_limits, empty_cloud
from depthcli.commands._flags import FLAGS
from depthcli.commands._old_batch import DEPTH_RESULTS, BatchCommand
from depthcli.commands._old_options import DRY_RUN, HTML_FLAG, LAYOUT, OUTPUT, RUN, SCENES
from depthcli.commands._scenes import find_maps
from depthcli.core.errors import ConfigError, InputError
from depthcli.core.option import Option
from depthcli.io.scenes.disparity_map import DisparityScene
from depthcli.run.batch import Outcome
from depthcli.run.command import Values
from depthcli.run.console import SIZE, Column, Reporter, percent
from depthcli.run.json_csv import Row

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from depthcli.core.cameras.triangulation import PairGeometry
    from depthcli.io.formats.pictures import Palette


class DepthOptions(TypedDict):
    """Options of a run of ``depth``, as ``run.yaml`` holds them; None: not given."""

    focal: float | None
    baseline: float | None
    doffs: float | None
    mask: str | None
    ply: bool
    near: float
    far: float | None
    depth_scale: float


class DepthCommand(BatchCommand[DepthOptions, DisparityScene]):
    """``depthcli depth RUN --output DIR [--calibration FILE]``."""

    results: ClassVar[tuple[str, ...]] = DEPTH_RESULTS
    shown_as: ClassVar[str] = "depth"

    arguments = (
        Option("run", Path, "Run folder of stereo or fuse, or one disparity map.", "RUN", required=True, group="Input"),
    )

    options = (
        OUTPUT,
        SCENES,
        Option("input", Path, "Folder of the run's scenes, if it has moved.", "DIR", short="-i", group="Input"),
        LAYOUT,
        Option("left", Path, "Left image of a single map, for the point cloud.", "FILE", group="Input"),
        Option("calibration", Path, "Calibration of all scenes: calib.txt, or KITTI's.", "FILE", group="Input"),
        Option("focal", float, "Focal length, instead of a calibration file.", "PIXELS", min_value=1e-6,
               group="Input"),
        Option("baseline", float, "Distance of the cameras, instead of a calibration file.", "METERS",
               min_value=1e-9, group="Input"),
        Option("doffs", float, "x of the right principal point minus the left one's.", "PIXELS", group="Input"),
        Option("mask", str, "Pixels that get a depth: all, measured, or confident:0.8, the 80 % of the measured ones "
               "with the highest confidence (confident:0.8:NAME of several). Default: all, in clouds measured.",
               "WHICH", group="Output"),
        Option("ply", bool, "Also write a colored point cloud of every scene.", default=False, group="Output"),
        Option("near", float, "Nearest depth of point clouds.", "METERS", default=0.0, min_value=0.0, group="Output"),
        Option("far", float, "Farthest depth of point clouds.", "METERS", min_value=0.0, group="Output"),
        Option("depth_scale", float, "Codes per meter in depth.png.", "CODES", default=1000.0, min_value=1e-3,
               max_value=1e6, group="Output"),
        *RUN,
        HTML_FLAG,
        *FLAGS,
        DRY_RUN,
    )  # fmt: skip

    page = "how_to/rig_to_meters"
    examples = (
        "depthcli depth runs/accurate --output depth --ply --far 10",
        "depthcli depth disp_left.pfm --focal 700 --baseline 0.12 --output depth",
    )

    def run(self, values: Values, reporter: Reporter) -> int:
        """Turn every map of the run into depth; return the exit code."""
        by_hand = [name for name in ("focal", "baseline", "doffs") if values[name] is not None]
        if by_hand and (values["focal"] is None or values["baseline"] is None):
            raise ConfigError("--focal and --baseline belong together (and --doffs, where the cameras have one)")
        if by_hand and values["calibration"] is not None:
            raise ConfigError(f"--calibration and --{by_hand[0]} exclude each other")
        from depthcli.api.results import parse_mask

        check_limits(values["near"], values["far"])
        parse_mask(values["mask"] or "all")
        config = DepthOptions(
            focal=values["focal"], baseline=values["baseline"], doffs=values["doffs"],
            mask=values["mask"], ply=values["ply"], near=values["near"], far=values["far"],
            depth_scale=values["depth_scale"],
        )  # fmt: skip
        return self.run_on(config, find_maps(values, reporter), values, reporter)

    def settings(self, config: DepthOptions, scene: DisparityScene) -> dict[str, str]:
        return {"cameras": f"{scene.cameras}"}

    def memory_of(self, config: DepthOptions, scene: DisparityScene) -> None:
        """Return None, since it is little more than the map itself; InputError where there is no calibration."""
        if config["focal"] is None:
            _geometry(config, scene)

    def columns(self) -> tuple[Column, ...]:

        def number(key: str, unit: str) -> Column:
            return Column(key.replace("_", " "), lambda row: f"{row[key]:.4g} {unit}" if row.get(key) else "-")

        return (SIZE, Column("density", percent("density")), number("median_depth", "m"), number("focal", "px"),
                number("baseline", "m"))  # fmt: skip

    def palette(self) -> Palette:
        from depthcli.io.formats.pictures import STATUS_PALETTE

        return STATUS_PALETTE

    def compute(self, config: DepthOptions, scene: DisparityScene, folder: Path, memory: int) -> Outcome:
        """Compute the depth of one map.

        Raises
        ------
        InputError
            The files cannot be used, or there is no calibration.
        """
        import numpy as np

        from depthcli.api.results import PointCloud, write_depth
        from depthcli.core.frames import color8
        from depthcli.core.maps import MatchedMap
        from depthcli.core.result import Clock
        from depthcli.io.formats.depth import MAX_DEPTH, MIN_DEPTH, beyond_png
        from depthcli.io.formats.images import read_image
        from depthcli.io.formats.pictures import read_status

        clock = Clock()
        clock.start("load")
        disparity = scene.load()
        height, width = disparity.shape
        geometry = _geometry(config, scene).for_size(width, height)
        status = np.zeros(disparity.shape, np.uint8) if scene.status is None else read_status(scene.status)
        _same_size(scene.status, status, disparity)
        image = None
        if config["ply"]:
            if scene.left is None:
                raise InputError(f"{scene.folder}: the left image is missing, which colors a point cloud; give --input")
            image = color8(read_image(scene.left))
            _same_size(scene.left, image, disparity)
        clock.start("depth")
        kept = _mask(config["mask"] or "all", scene, disparity, status)
        depth = geometry.depth(np.where(kept, disparity, np.float32(np.nan)))
        clock.start("save")
        in_cloud = _mask(config["mask"] or "measured", scene, disparity, status)
        in_cloud &= (depth >= config["near"]) & (depth <= (math.inf if config["far"] is None else config["far"]))
        found = MatchedMap(depth, status)
        write_depth(found, folder, config["depth_scale"])
        if image is not None:
            PointCloud.of(found, geometry.left, image, in_cloud).save(folder / "points.ply")
        known = np.isfinite(depth)
        beyond, beyond_warning = beyond_png(depth, config["depth_scale"])
        facts: Row = {
            "width": width,
            "height": height,
            "density": round(float(known.mean()), 6),
            "median_depth": round(float(np.median(depth[known])), 6) if known.any() else None,
            "focal": geometry.left.fx,
            "baseline": geometry.baseline,
            "doffs": geometry.offset,
            "beyond_png": round(beyond, 6),
        }
        if image is not None:
            facts["points"] = int(np.count_nonzero(known & in_cloud))
        warnings = [] if image is None else empty_cloud(depth, in_cloud)
        warnings += [f"{beyond_warning}; see --depth-scale"] if beyond_warning else []
        median = facts["median_depth"]
        if median is not None and not MIN_DEPTH <= median <= MAX_DEPTH:
            warnings.append(
                f"the median depth is {median:.4g} m, with a focal length of {geometry.left.fx:.4g} px and a baseline "
                f"of {geometry.baseline:.4g} m; is the calibration that of this map?"
            )
        return Outcome(facts, clock.seconds, warnings)


def _geometry(config: DepthOptions, scene: DisparityScene) -> PairGeometry:
    from depthcli.core.cameras.camera import Intrinsics
    from depthcli.core.cameras.triangulation import PairGeometry
    from depthcli.io.formats.calibrations import read_geometry

    if config["focal"] is not None and config["baseline"] is not None:
        height, width = scene.load().shape
        camera = Intrinsics(config["focal"], config["focal"], (width - 1) / 2, (height - 1) / 2)
        return PairGeometry(camera, config["baseline"], config["doffs"] or 0.0)
    if scene.geometry is not None:
        return scene.geometry
    if scene.calibration is None:
        raise InputError(
            f"{scene.folder}: no calibration beside the images; give --calibration, or --focal, --baseline"
        )
    return read_geometry(scene.calibration, scene.cameras)


def _mask(
    text: str, scene: DisparityScene, disparity: NDArray[np.float32], status: NDArray[np.uint8]
) -> NDArray[np.bool_]:
    """Return the pixels that ``--mask`` chooses."""
    from depthcli.api.results import chosen_pixels
    from depthcli.core.maps import DisparityMap
    from depthcli.io.formats.disparity import read_pfm
    from depthcli.io.formats.files import naming

    confidence = {}
    if text.startswith("confident"):
        for name, file in scene.confidence.items():
            confidence[name] = read_pfm(file)
            _same_size(file, confidence[name], disparity)
    with naming(scene.folder):
        return chosen_pixels(DisparityMap(disparity, status), text, confidence)


def _same_size(path: Path | None, values: NDArray[np.generic], disparity: NDArray[np.float32]) -> None:
    if values.shape[:2] != disparity.shape:
        raise InputError(
            f"{path}: {values.shape[1]} x {values.shape[0]}, but the disparity map is "
            f"{disparity.shape[1]} x {disparity.shape[0]}"
        )


COMMAND = DepthCommand()
