"""What ``depth`` computes of a disparity map."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from depthcli.api.results import PointCloud, chosen_pixels, parse_mask, write_depth
from depthcli.commands._batch import run_batch
from depthcli.commands._clouds import check_limits, empty_cloud
from depthcli.commands._options import CloudOptions, MapOptions, RunOptions
from depthcli.commands._scenes import scenes_at
from depthcli.core.cameras.camera import Intrinsics
from depthcli.core.cameras.triangulation import PairGeometry
from depthcli.core.errors import ConfigError, InputError
from depthcli.core.frames import color8
from depthcli.core.maps import DisparityMap, MatchedMap
from depthcli.core.result import Clock
from depthcli.io.formats.calibrations import read_geometry
from depthcli.io.formats.depth import MAX_DEPTH, MIN_DEPTH, beyond_png
from depthcli.io.formats.disparity import read_pfm
from depthcli.io.formats.files import naming
from depthcli.io.formats.images import read_image
from depthcli.io.formats.pictures import STATUS_PALETTE, read_status
from depthcli.io.inputs import local
from depthcli.io.scenes import Scene, check_same_size
from depthcli.io.scenes.maps import DisparityScene
from depthcli.io.scenes.stereo import StereoScene
from depthcli.io.walk import matches_any, scenes_with_files
from depthcli.run.batch import Batch, Outcome
from depthcli.run.console import SIZE, Column, Reporter, percent
from depthcli.run.json_csv import Row
from depthcli.run.records import is_inside
from depthcli.run.report import read_report

_MAP = "disp_left.pfm"


class DepthConfig(TypedDict):
    """Options of a run of ``depth``, as ``run.yaml`` holds them; None: not given."""

    focal: float | None
    baseline: float | None
    doffs: float | None
    mask: str | None
    ply: bool
    near: float
    far: float | None
    depth_scale: float


def depth_of_maps(maps: MapOptions, clouds: CloudOptions, run: RunOptions) -> int:
    """Turn every map of a run into depth; return the exit code."""
    by_hand = [name for name in ("focal", "baseline", "doffs") if getattr(maps, name) is not None]
    if by_hand and (maps.focal is None or maps.baseline is None):
        raise ConfigError("--focal and --baseline belong together (and --doffs, where the cameras have one)")
    if by_hand and maps.calibration is not None:
        raise ConfigError(f"--calibration and --{by_hand[0]} exclude each other")
    check_limits(clouds.near, clouds.far)
    parse_mask(clouds.mask or "all")
    config = DepthConfig(
        focal=maps.focal, baseline=maps.baseline, doffs=maps.doffs, mask=clouds.mask, ply=clouds.ply, near=clouds.near,
        far=clouds.far, depth_scale=clouds.depth_scale,
    )  # fmt: skip
    compute = _ToDepth(config)
    numbers = (_number("median_depth", "m"), _number("focal", "px"), _number("baseline", "m"))
    columns = (SIZE, Column("density", percent("density")), *numbers)
    batch = Batch(
        command="depth", config=config, compute=compute, columns=columns, settings=_settings, memory=compute.memory,
        palette=STATUS_PALETTE, shown_as="depth",
    )  # fmt: skip
    return run_batch(batch, find_maps(maps, run.reporter), run)


def _number(key: str, unit: str) -> Column:
    return Column(key.replace("_", " "), lambda row: f"{row[key]:.4g} {unit}" if row.get(key) else "-")


def _settings(scene: DisparityScene) -> dict[str, str]:
    return {"cameras": f"{scene.cameras}"}


@dataclass(frozen=True)
class _ToDepth:
    """Computes the depth of one map."""

    config: DepthConfig

    def memory(self, scene: DisparityScene) -> None:
        """Return None, since it is little more than the map itself; InputError where there is no calibration."""
        if self.config["focal"] is None:
            self._geometry(scene, (1, 1))

    def __call__(self, scene: DisparityScene, folder: Path, memory: int) -> Outcome:
        config, clock = self.config, Clock()
        clock.start("load")
        disparity = scene.load()
        height, width = disparity.shape
        geometry = self._geometry(scene, disparity.shape).for_size(width, height)

        def check(file: Path | None, values: NDArray[np.generic]) -> None:
            if file is not None:
                check_same_size(file, values.shape, scene.disparity, disparity.shape)

        status = np.zeros(disparity.shape, np.uint8) if scene.status is None else read_status(scene.status)
        check(scene.status, status)
        confidence = {}
        if (config["mask"] or "").startswith("confident"):
            for name, file in scene.confidence.items():
                confidence[name] = read_pfm(file)
                check(file, confidence[name])
        image = None
        if config["ply"]:
            if scene.left is None:
                raise InputError(f"{scene.folder}: the left image is missing, which colors a point cloud; give --input")
            image = color8(read_image(scene.left))
            check(scene.left, image)
        clock.start("depth")
        matched = DisparityMap(disparity, status)
        with naming(scene.folder):
            kept = chosen_pixels(matched, config["mask"] or "all", confidence)
            in_cloud = chosen_pixels(matched, config["mask"] or "measured", confidence)
        depth = geometry.depth(np.where(kept, disparity, np.float32(np.nan)))
        in_cloud &= (depth >= config["near"]) & (depth <= (math.inf if config["far"] is None else config["far"]))
        clock.start("save")
        found = MatchedMap(depth, status)
        write_depth(found, folder, config["depth_scale"])
        if image is not None:
            PointCloud.of(found, geometry.left, image, in_cloud).save(folder / "points.ply")
        known = np.isfinite(depth)
        median = round(float(np.median(depth[known])), 6) if known.any() else None
        beyond, beyond_warning = beyond_png(depth, config["depth_scale"])
        facts: Row = {"width": width, "height": height, "density": round(float(known.mean()), 6)}
        facts |= {"median_depth": median, "focal": geometry.left.fx, "baseline": geometry.baseline}
        facts |= {"doffs": geometry.offset, "beyond_png": round(beyond, 6)}
        if image is not None:
            facts["points"] = int(np.count_nonzero(known & in_cloud))
        warnings = [] if image is None else empty_cloud(depth, in_cloud)
        warnings += [f"{beyond_warning}; see --depth-scale"] if beyond_warning else []
        if median is not None and not MIN_DEPTH <= median <= MAX_DEPTH:
            warnings.append(
                f"the median depth is {median:.4g} m, with a focal length of {geometry.left.fx:.4g} px and a baseline "
                f"of {geometry.baseline:.4g} m; is the calibration that of this map?"
            )
        return Outcome(facts, clock.seconds, warnings)

    def _geometry(self, scene: DisparityScene, shape: tuple[int, ...]) -> PairGeometry:
        focal, baseline = self.config["focal"], self.config["baseline"]
        if focal is not None and baseline is not None:
            camera = Intrinsics(focal, focal, (shape[1] - 1) / 2, (shape[0] - 1) / 2)
            return PairGeometry(camera, baseline, self.config["doffs"] or 0.0)
        if scene.geometry is not None:
            return scene.geometry
        if scene.calibration is None:
            raise InputError(
                f"{scene.folder}: no calibration beside the images; give --calibration, or --focal, --baseline"
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
    run = local(maps.run)
    if os.path.isfile(run):
        return [
            DisparityScene(
                name=run.stem, folder=run.parent, disparity=run, left=maps.left, calibration=maps.calibration
            )
        ]
    rows = read_report(run)
    names = _names_of_maps(run, [name for name in rows if is_inside(name)], maps.scenes or ["*"])
    done = {name for name, row in rows.items() if row.get("status") == "done" and is_inside(name)}
    missing = sorted(name for name in done - set(names) if matches_any(name, maps.scenes or ["*"]))
    sources = {name: local(source) for name in names if (source := rows.get(name, {}).get("source"))}
    inputs: dict[str, Scene]
    if maps.input is not None:
        inputs = {scene.name: scene for scene in scenes_at(maps.input, (StereoScene,), maps.layout, ["*"], reporter)}
    else:
        known = scenes_with_files(sources.values())
        inputs = {name: known[source] for name, source in sources.items() if source in known}
    found = [_map_of(run / name, name, inputs.get(name), sources.get(name), maps) for name in names]
    for name in missing:
        problem = f"{run / name}: no {_MAP}, though the run's report lists the scene as done; run it again"
        found.append(DisparityScene(name=name, folder=run / name, disparity=run / name / _MAP, problem=problem))
    return sorted(found, key=lambda scene: scene.name)


def _names_of_maps(run: Path, reported: Sequence[str], patterns: Sequence[str]) -> list[str]:
    if not os.path.isdir(run):
        raise InputError(f"{run}: no such run folder or map")
    names = {name for name in reported if os.path.isfile(run / name / _MAP)}
    found = [*run.glob(f"*/{_MAP}"), *run.glob(f"*/*/{_MAP}")]
    names |= {file.parent.relative_to(run).as_posix() for file in found}
    chosen = sorted(name for name in names if not name.startswith(".") and matches_any(name, patterns))
    if not chosen:
        raise InputError(f"{run}: no {'scene matches' if names else 'disparity maps there'} (SCENE/{_MAP})")
    return chosen


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
    status = folder / "status.png"
    return DisparityScene(
        name=name,
        folder=folder,
        disparity=folder / _MAP,
        status=status if os.path.isfile(status) else None,
        confidence={path.stem.partition("_")[2]: path for path in sorted(folder.glob("confidence_*.pfm"))},
        left=left,
        calibration=maps.calibration or (calibration if maps.focal is None else None),
        cameras=cameras,
        geometry=geometry if maps.calibration is None else None,
    )
