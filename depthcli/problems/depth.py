"""Compute metric depth and point clouds from the disparity maps of a run, or from a single map."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.core.cameras.camera import Intrinsics
from depthcli.core.cameras.triangulation import PairGeometry
from depthcli.core.context import Context
from depthcli.core.errors import ConfigError, InputError
from depthcli.core.maps import DisparityMap
from depthcli.io.formats.calibrations import Reading, read_geometry
from depthcli.io.formats.depth import MAX_DEPTH, MIN_DEPTH, beyond_png
from depthcli.io.formats.disparity import check_sign, read_foreign_map, read_pfm, read_status
from depthcli.io.formats.files import collected_warnings, is_of_a_run, naming, shown
from depthcli.io.formats.images import read_image
from depthcli.io.scenes import DisparityScene, Scene, StereoScene, check_same_size
from depthcli.io.scenes.find import matches_any, scenes_with_files
from depthcli.io.scenes.pairs import PAIRS
from depthcli.io.scenes.places import local
from depthcli.problems.problem import DEPTH_FILES, SceneJob, Shown
from depthcli.problems.results import (
    Depth,
    PointCloud,
    check_limits,
    chosen_pixels,
    cloud_pixels,
    depth_of,
    empty_cloud,
    mask_parts,
)
from depthcli.run.job import Outcome
from depthcli.run.records import is_inside, read_json, read_report
from depthcli.show.table import SIZE, Row, number, percent, share, size_of
from depthcli.show.table import median as median_of
from depthcli.show.view import STATUS_PALETTE

_MAP = "disp_left.pfm"


@dataclass(frozen=True)
class ToDepth(SceneJob[DisparityScene]):
    """Turn disparity maps into depth and point clouds. Raise ConfigError if options contradict each other."""

    command = "depth"
    writes = DEPTH_FILES
    shown = Shown(
        (
            SIZE,
            percent("density"),
            number("median_depth", "{:.4g} m"),
            number("median_bound", "{:.3g} m"),
            number("focal", "{:.4g} px"),
            number("baseline", "{:.4g} m"),
        ),
        palette=STATUS_PALETTE,
        protocol="depth",
    )

    config: Mapping[str, Any]  # option -> value, or None if it is not given

    def __post_init__(self) -> None:
        config = self.config
        numbers = [config[name] for name in ("focal", "baseline", "doffs")]
        if numbers != [None] * 3 and None in numbers[:2]:
            raise ConfigError("--focal and --baseline belong together (and --doffs, where the cameras have one)")
        check_limits(config["near"], config["far"])
        mask_parts(config["mask"] or "all")

    def files(self, scene: DisparityScene) -> dict[str, Path]:
        """Return role -> file for the map, its related files, and a calibration's second file."""
        second = self.config.get("second_calibration")
        return scene.input_files | ({} if second is None else {"second_calibration": Path(second)})

    def settings(self, scene: DisparityScene) -> dict[str, str]:
        """Return the numbers of the pair's cameras in the calibration."""
        return {"cameras": f"{scene.cameras}"}

    def memory(self, scene: DisparityScene) -> None:
        """Return None, since little more than the map is needed. Raise InputError without a calibration."""
        if self.config["focal"] is None:
            with collected_warnings():  # compute() repeats them
                self._geometry(scene)

    def compute(self, scene: DisparityScene, folder: Path, context: Context) -> Outcome:
        """Load a map with its status, confidence and bound, compute its depth, and save depth and cloud."""
        config, clock = self.config, context.clock
        clock.start("load")
        scene.check()
        disparity = read_foreign_map(scene.disparity, config.get("scale"), config.get("invalid"))
        height, width = disparity.shape
        stored = self._geometry(scene, disparity.shape)
        geometry = stored.for_size(width, height)
        with naming(scene.disparity):
            check_sign("disparities", disparity, geometry.offset)

        def read(reader: Callable[[Path], NDArray[Any]], file: Path) -> NDArray[Any]:
            values = reader(file)
            check_same_size(file, values.shape, scene.disparity, disparity.shape)
            return values

        status = np.zeros(disparity.shape, np.uint8) if scene.status is None else read(read_status, scene.status)
        ranked = (config["mask"] or "").startswith("confident")
        confidence = {name: read(read_pfm, file) for name, file in scene.confidence.items() if ranked}
        image = np.zeros(disparity.shape, np.uint8)  # the colors of a cloud
        if config["ply"]:
            if scene.left is None:
                raise InputError(f"{scene.folder}: the left image is missing, which colors a point cloud; give --input")
            image = read(read_image, scene.left)
        clock.start("depth")
        matched = DisparityMap(disparity, status)
        bound = None if scene.bound is None else read(read_pfm, scene.bound)
        with naming(scene.folder):
            kept = chosen_pixels(matched, config["mask"] or "all", confidence)
            in_cloud = chosen_pixels(matched, config["mask"] or "measured", confidence)
            depth = depth_of(matched, geometry, image, kept, bound)
            limits = config["near"], config["far"] or math.inf, config["max_bound"]
            in_cloud = cloud_pixels(depth, depth.bound, in_cloud, *limits)
        clock.start("save")
        depth.save(folder, config["depth_scale"])
        beyond, beyond_warning = beyond_png(depth.values, config["depth_scale"])
        row = _row_of(depth, geometry, beyond)
        warnings = [doubt] if (doubt := stored.doubts(width, height)) else []
        if config["ply"]:
            PointCloud.of(depth, geometry.left, image, in_cloud).save(folder / "points.ply")
            row["points"] = int(np.count_nonzero(np.isfinite(depth.values) & in_cloud))
            warnings += empty_cloud(depth.values, in_cloud)
        warnings += [f"{beyond_warning}; see --depth-scale"] if beyond_warning else []
        return Outcome(row, clock.seconds, warnings + _implausible(row))

    def _geometry(self, scene: DisparityScene, shape: tuple[int, ...] | None = None) -> PairGeometry:
        """Return the cameras from the options, or from the scene's calibration; raise InputError without any.

        ``shape`` (H, W) is that of the map, if it is known.
        """
        focal, baseline = self.config["focal"], self.config["baseline"]
        if focal is not None and shape is not None:
            camera = Intrinsics(focal, focal, (shape[1] - 1) / 2, (shape[0] - 1) / 2)
            return PairGeometry(camera, baseline, self.config["doffs"] or 0.0)
        if scene.geometry is not None:
            return scene.geometry
        if scene.calibration is None:
            raise InputError(
                f"{scene.folder}: no calibration with the images; give --calibration, or --focal, --baseline"
            )
        files = [scene.calibration, *map(Path, filter(None, [self.config.get("second_calibration")]))]
        calib_file = scene.folder / "calib.txt"
        size = None if shape is None else (shape[1], shape[0])
        rectified = calib_file if os.path.isfile(calib_file) and os.path.isfile(scene.folder / "left.png") else None
        given = {key: self.config[key] for key in ("unit", "fisheye", "cameras", "alpha") if key in self.config}
        is_own = rectified is not None and scene.calibration == rectified and is_of_a_run(rectified)
        # The unit of our own calibration is known, whatever the baseline is.
        own: dict[str, Any] = {"cameras": scene.cameras, "asks": not is_own}
        return read_geometry(files, Reading(**(own | given)), size, rectified)


def _row_of(depth: Depth, geometry: PairGeometry, beyond: float) -> Row:
    """Return the report's columns; ``beyond`` is the share of the depths that ``depth.png`` cannot hold."""
    valid = np.isfinite(depth.values)
    median = round(float(np.median(depth.values[valid])), 6) if valid.any() else None
    row: Row = {**size_of(depth.values), "density": share(valid)}
    row |= {"median_depth": median, "focal": geometry.left.fx, "baseline": geometry.baseline}
    row |= {"doffs": geometry.offset, "beyond_png": round(beyond, 6)}
    return row if depth.bound is None else row | {"median_bound": median_of(depth.bound)}


def _implausible(row: Row) -> list[str]:
    """Return a warning if the median depth is too near or too far for a scene."""
    median = row["median_depth"]
    if median is None or MIN_DEPTH <= median <= MAX_DEPTH:
        return []
    return [
        f"the median depth is {median:.4g} m, with a focal length of {row['focal']:.4g} px and a baseline "
        f"of {row['baseline']:.4g} m; does the calibration belong to this map?"
    ]


def find_maps(
    run: Path,
    patterns: Sequence[str] = ("*",),
    left: Path | None = None,
    calibration: Path | None = None,
    by_hand: bool = False,
    pairs: Callable[[], Sequence[Scene]] | None = None,
) -> list[DisparityScene]:
    """Return the disparity maps of a run, or a single map, with their left images and calibrations.

    If the report lists a scene as done but its map is missing, the scene has a ``problem``. Raise InputError if there
    is no such run, or no map of a matching scene.

    Parameters
    ----------
    run : run folder, or file of a map
    patterns : shell patterns of the names of scenes
    left : left image of a single map
    calibration : calibration for all maps, instead of their own
    by_hand : whether numbers describe the cameras, instead of calibrations
    pairs : returns the matched image pairs; None: the run's report gives their places
    """
    run = local(run)
    if os.path.isfile(run):
        single = DisparityScene(name=run.stem, folder=run.parent, disparity=run)
        if run.name == _MAP and is_of_a_run(run):  # with the run's other files
            single = _map_of(run.parent, run.stem, None, None)
        if calibration is not None or by_hand:
            single = replace(single, calibration=calibration)
        return [single if left is None else replace(single, left=left)]
    if not os.path.isdir(run):
        raise InputError(f"{run}: no such run folder or map")
    rows = {name: row for name, row in read_report(run).items() if is_inside(name)}
    files = [*(run / name / _MAP for name in rows), *run.glob(f"*/{_MAP}"), *run.glob(f"*/*/{_MAP}")]
    there = {file.parent.relative_to(run).as_posix() for file in files if os.path.isfile(file)}
    names = [name for name in sorted(there) if not name.startswith(".") and matches_any(name, patterns)]
    if not names:
        raise InputError(f"{run}: no {'scene matches' if there else 'disparity maps there'} (SCENE/{_MAP})")
    sources = {name: local(source) for name in names if (source := rows.get(name, {}).get("source"))}
    if pairs is not None:
        matched = {scene.name: scene for scene in pairs()}
    else:
        by_file = scenes_with_files(sources.values(), PAIRS)
        matched = {name: by_file[source] for name, source in sources.items() if source in by_file}
    maps = [_map_of(run / name, name, matched.get(name), sources.get(name)) for name in names]
    if calibration is not None:
        maps = [replace(each, calibration=calibration, geometry=None) for each in maps]
    elif by_hand:
        maps = [replace(each, calibration=None) for each in maps]
    for name, row in rows.items():
        if row["status"] == "done" and name not in names and matches_any(name, patterns):
            problem = f"{run / name}: no {_MAP}, though the run's report lists the scene as done; run it again"
            maps.append(DisparityScene(name=name, folder=run / name, disparity=run / name / _MAP, problem=problem))
    return sorted(maps, key=lambda scene: scene.name)


def _map_of(folder: Path, name: str, pair: Scene | None, source: Path | None) -> DisparityScene:
    """Return the map in ``folder``; ``pair`` is its scene and ``source`` its left image, if known."""
    left = source if source is not None and os.path.isfile(source) else None
    calibration, cameras, geometry = None, (2, 3), None
    if isinstance(pair, StereoScene):
        left, calibration, cameras, geometry = pair.left, pair.calibration, pair.cameras, pair.geometry
    if all(os.path.isfile(folder / name) for name in ("calib.txt", "left.png")):  # the run rectified the pair
        left, calibration, cameras, geometry = folder / "left.png", folder / "calib.txt", (2, 3), None
    elif pair is None and left is not None and os.path.isfile(calib_file := left.parent / "calib.txt"):
        calibration = calib_file
    problem = ""
    if left is not None and isinstance(meta := read_json(left.parent / "meta.json"), dict) and "uncalibrated" in meta:
        problem = (
            f"{shown(left.parent)}: rectified without a calibration: its disparities have no known zero, so depth is "
            "unknown; calibrate the cameras (depthcli calibrate), and rectify with --calibration"
        )
    status, bound = folder / "status.png", folder / "bound.pfm"
    confidences = [*sorted(folder.glob("confidence_*.pfm")), *folder.glob("probability.pfm")]
    return DisparityScene(
        name=name,
        folder=folder,
        problem=problem,
        disparity=folder / _MAP,
        status=status if os.path.isfile(status) else None,
        confidence={path.stem.removeprefix("confidence_"): path for path in confidences},
        bound=bound if os.path.isfile(bound) else None,
        left=left,
        calibration=calibration,
        cameras=cameras,
        geometry=geometry,
    )
