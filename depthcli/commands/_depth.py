"""What ``depth`` computes of a disparity map."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from depthcli.api.results import PointCloud
from depthcli.api.saving import check_limits, chosen_pixels, empty_cloud, parse_mask, write_depth
from depthcli.commands._options import CloudOptions, MapOptions, RunOptions
from depthcli.core.cameras.camera import Intrinsics
from depthcli.core.cameras.triangulation import PairGeometry
from depthcli.core.context import Context
from depthcli.core.errors import ConfigError, InputError
from depthcli.core.frames import color8
from depthcli.core.maps import DisparityMap, MatchedMap
from depthcli.io.formats.calibrations import read_geometry
from depthcli.io.formats.depth import MAX_DEPTH, MIN_DEPTH, beyond_png
from depthcli.io.formats.disparity import read_disparity, read_pfm
from depthcli.io.formats.files import naming, shown
from depthcli.io.formats.images import read_image
from depthcli.io.formats.pictures import STATUS_PALETTE, read_status
from depthcli.io.scenes import DisparityScene, Scene, StereoScene, check_same_size
from depthcli.io.scenes.find import matches_any, scenes_at, scenes_with_files
from depthcli.io.scenes.pairs import PAIRS
from depthcli.io.scenes.places import local
from depthcli.problems.problem import SceneJob, Shown
from depthcli.run.console import SIZE, Reporter, number, percent
from depthcli.run.job import Outcome
from depthcli.run.json_csv import Row, share
from depthcli.run.json_csv import median as median_of
from depthcli.run.records import is_inside, read_json
from depthcli.run.report import read_report

_MAP = "disp_left.pfm"


def prepare(maps: MapOptions, clouds: CloudOptions, run: RunOptions) -> tuple[ToDepth, list[DisparityScene]]:
    """Return the batch of ``depth``, and the maps that the options name; ConfigError where options do not fit."""
    by_hand = {name: getattr(maps, name) for name in ("focal", "baseline", "doffs")}
    given = [name for name, value in by_hand.items() if value is not None]
    if given and (maps.focal is None or maps.baseline is None):
        raise ConfigError("--focal and --baseline belong together (and --doffs, where the cameras have one)")
    if given and maps.calibration is not None:
        raise ConfigError(f"--calibration and --{given[0]} exclude each other")
    check_limits(clouds.near, clouds.far)
    parse_mask(clouds.mask or "all")
    return ToDepth(by_hand | vars(clouds)), find_maps(maps, run.reporter)


@dataclass(frozen=True)
class ToDepth(SceneJob[DisparityScene]):
    """Turns disparity maps into depth and point clouds; ``config`` has the options, None for one that is not given."""

    command = "depth"
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

    config: Mapping[str, Any]

    def settings(self, scene: DisparityScene) -> dict[str, str]:
        """Return which cameras of the calibration took the pair."""
        return {"cameras": f"{scene.cameras}"}

    def memory(self, scene: DisparityScene) -> None:
        """Return None, since it is little more than the map itself; InputError without a calibration."""
        if self.config["focal"] is None:
            self._geometry(scene, (1, 1))

    def compute(self, scene: DisparityScene, folder: Path, context: Context) -> Outcome:
        """Load a map with what belongs to it, choose pixels, compute their depth, save it and the cloud."""
        config, clock = self.config, context.clock
        clock.start("load")
        scene.check()
        disparity = read_disparity(scene.disparity)
        height, width = disparity.shape
        geometry = self._geometry(scene, disparity.shape).for_size(width, height)

        def read(reader: Callable[[Path], NDArray[Any]], file: Path) -> NDArray[Any]:
            values = reader(file)
            check_same_size(file, values.shape, scene.disparity, disparity.shape)
            return values

        status = np.zeros(disparity.shape, np.uint8) if scene.status is None else read(read_status, scene.status)
        ranked = (config["mask"] or "").startswith("confident")
        confidence = {name: read(read_pfm, file) for name, file in scene.confidence.items() if ranked}
        if config["ply"] and scene.left is None:
            raise InputError(f"{scene.folder}: the left image is missing, which colors a point cloud; give --input")
        image = color8(read(read_image, scene.left)) if config["ply"] and scene.left is not None else None
        clock.start("depth")
        matched = DisparityMap(disparity, status)
        with naming(scene.folder):
            kept = chosen_pixels(matched, config["mask"] or "all", confidence)
            in_cloud = chosen_pixels(matched, config["mask"] or "measured", confidence)
        values = np.where(kept, disparity, np.float32(np.nan))
        depth, bound = geometry.depth(values), None
        if scene.bound is not None:
            bound = geometry.depth_bound(values, read(read_pfm, scene.bound))
        in_cloud &= (depth >= config["near"]) & (depth <= (math.inf if config["far"] is None else config["far"]))
        if config["max_bound"] is not None:
            if bound is None:
                raise InputError(f"{scene.folder}: no bound.pfm for --max-bound; match with --bound")
            in_cloud &= bound <= config["max_bound"]
        clock.start("save")
        found = MatchedMap(depth, status)
        write_depth(found, folder, config["depth_scale"], bound=bound)
        known = np.isfinite(depth)
        median = round(float(np.median(depth[known])), 6) if known.any() else None
        beyond, beyond_warning = beyond_png(depth, config["depth_scale"])
        facts: Row = {"width": width, "height": height, "density": share(known)}
        facts |= {"median_depth": median, "focal": geometry.left.fx, "baseline": geometry.baseline}
        facts |= {"doffs": geometry.offset, "beyond_png": round(beyond, 6)}
        if bound is not None:
            facts["median_bound"] = median_of(bound)
        warnings = []
        if image is not None:
            PointCloud.of(found, geometry.left, image, in_cloud).save(folder / "points.ply")
            facts["points"] = int(np.count_nonzero(known & in_cloud))
            warnings += empty_cloud(depth, in_cloud)
        warnings += [f"{beyond_warning}; see --depth-scale"] if beyond_warning else []
        if median is not None and not MIN_DEPTH <= median <= MAX_DEPTH:
            warnings.append(
                f"the median depth is {median:.4g} m, with a focal length of {geometry.left.fx:.4g} px and a baseline "
                f"of {geometry.baseline:.4g} m; does the calibration belong to this map?"
            )
        return Outcome(facts, clock.seconds, warnings)

    def _geometry(self, scene: DisparityScene, shape: tuple[int, ...]) -> PairGeometry:
        focal, baseline = self.config["focal"], self.config["baseline"]
        if focal is not None:
            camera = Intrinsics(focal, focal, (shape[1] - 1) / 2, (shape[0] - 1) / 2)
            return PairGeometry(camera, baseline, self.config["doffs"] or 0.0)
        if scene.geometry is not None:
            return scene.geometry
        if scene.calibration is None:
            raise InputError(
                f"{scene.folder}: no calibration with the images; give --calibration, or --focal, --baseline"
            )
        return read_geometry(scene.calibration, scene.cameras)


def find_maps(maps: MapOptions, reporter: Reporter) -> list[DisparityScene]:
    """Return the disparity maps of a run, each with its left image and calibration, or a single map.

    A scene that the run's report lists as done, but whose map is gone, is among them with a ``problem``.

    Raises
    ------
    InputError
        There is no such run, or no map of a scene that matches ``--scenes``.
    """
    run, patterns = local(maps.run), maps.scenes or ["*"]
    if os.path.isfile(run):
        one = DisparityScene(name=run.stem, folder=run.parent, disparity=run)
        return [replace(one, left=maps.left, calibration=maps.calibration)]
    if not os.path.isdir(run):
        raise InputError(f"{run}: no such run folder or map")
    rows = {name: row for name, row in read_report(run).items() if is_inside(name)}
    files = [*(run / name / _MAP for name in rows), *run.glob(f"*/{_MAP}"), *run.glob(f"*/*/{_MAP}")]
    there = {file.parent.relative_to(run).as_posix() for file in files if os.path.isfile(file)}
    names = [name for name in sorted(there) if not name.startswith(".") and matches_any(name, patterns)]
    if not names:
        raise InputError(f"{run}: no {'scene matches' if there else 'disparity maps there'} (SCENE/{_MAP})")
    sources = {name: local(source) for name in names if (source := rows.get(name, {}).get("source"))}
    if maps.input is not None:
        pairs = scenes_at(maps.input, PAIRS, maps.layout, ["*"], reporter.info)
        inputs = {scene.name: cast(Scene, scene) for scene in pairs}
    else:
        known = scenes_with_files(sources.values(), PAIRS)
        inputs = {name: known[source] for name, source in sources.items() if source in known}
    found = [_map_of(run / name, name, inputs.get(name), sources.get(name), maps) for name in names]
    for name, row in rows.items():
        if row["status"] == "done" and name not in names and matches_any(name, patterns):
            problem = f"{run / name}: no {_MAP}, though the run's report lists the scene as done; run it again"
            found.append(DisparityScene(name=name, folder=run / name, disparity=run / name / _MAP, problem=problem))
    return sorted(found, key=lambda scene: scene.name)


def _map_of(folder: Path, name: str, pair: Scene | None, source: Path | None, maps: MapOptions) -> DisparityScene:
    """Return the map in ``folder``; ``pair`` is the scene it was made from, and ``source`` its left image, if known."""
    left = source if source is not None and os.path.isfile(source) else None
    calibration, cameras, geometry = None, (2, 3), None
    if isinstance(pair, StereoScene):
        left, calibration, cameras, geometry = pair.left, pair.calibration, pair.cameras, pair.geometry
    if all(os.path.isfile(folder / name) for name in ("calib.txt", "left.png")):  # the pair was rectified for the map
        left, calibration, cameras, geometry = folder / "left.png", folder / "calib.txt", (2, 3), None
    elif pair is None and left is not None and os.path.isfile(beside := left.parent / "calib.txt"):
        calibration = beside
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
        calibration=maps.calibration or (calibration if maps.focal is None else None),
        cameras=cameras,
        geometry=geometry if maps.calibration is None else None,
    )
