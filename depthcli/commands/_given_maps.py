"""What ``confidence`` and ``fuse maps`` compute of disparity maps made before, which are found and decoded first."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from depthcli.api.maps import fused, fusion_of, judge, judge_by_one_view, judge_of
from depthcli.commands._batch import run_batch
from depthcli.commands._options import CodingOptions, PairOptions, RangeOptions, RunOptions, ScoredRunOptions
from depthcli.commands._scenes import find_scenes
from depthcli.core.errors import ConfigError, DepthcliError, InputError
from depthcli.core.maps import Status
from depthcli.core.result import Clock
from depthcli.evaluation import protocols
from depthcli.evaluation.map_files import (
    DisparityFiles,
    MapFiles,
    MapNaming,
    by_run,
    find_runs,
    names_in_run,
    pattern_of,
    positive,
    recognized,
)
from depthcli.io.formats.files import collected_warnings
from depthcli.io.formats.images import image_size, read_image
from depthcli.io.formats.pictures import STATUS_PALETTE
from depthcli.io.inputs import local
from depthcli.io.scenes.maps import GivenMap, MapsScene
from depthcli.io.scenes.stereo import StereoScene
from depthcli.methods.given_maps import UsesNetworks
from depthcli.methods.given_maps.fusion import MAX_MAPS
from depthcli.run.batch import Batch, Outcome
from depthcli.run.console import SIZE, Column, Reporter, percent
from depthcli.run.report import read_report

__all__ = ["prepare_fusion", "prepare_judgment", "run_batch"]


class FuseMapsOptions(TypedDict):
    """Options of a run of ``fuse maps``, as ``run.yaml`` holds them; None: not given."""

    max_disparity: int | None
    within: float
    surfaces: bool


class ConfidenceOptions(TypedDict):
    """Options of a run of ``confidence``, as ``run.yaml`` holds them; None: not given."""

    max_disparity: int | None
    within: float
    keep: float | None
    threshold: float | None
    measures: list[str]


def prepare_fusion(
    maps: Sequence[str],
    pairs: RangeOptions,
    coding: CodingOptions,
    run: RunOptions,
    within: float,
    surfaces: bool,
    settings: Sequence[str] | None,
) -> tuple[Batch[MapsScene], list[MapsScene]]:
    """Return the batch of ``fuse maps``, and the pairs with their maps."""
    if not 1 <= len(maps) <= MAX_MAPS:
        raise ConfigError(f"--maps: give 1 to {MAX_MAPS} runs or maps (got {len(maps)})")
    unused = [name for name in ("calibration", "unit", "min_disparity") if getattr(pairs, name) is not None]
    if unused or settings:
        raise ConfigError(f"--{(unused or ['set'])[0].replace('_', '-')} does not go with fuse maps")
    config = FuseMapsOptions(
        max_disparity=_largest(pairs.max_disparity), within=_checked_within(within), surfaces=surfaces
    )
    batch = Batch(
        command="fuse-maps",
        config=config,
        compute=_FuseMaps(config),
        columns=(SIZE, Column("maps", lambda row: str(row.get("maps", "-"))),
                 Column("expected right", percent("expected_right")), Column("measured", percent("measured"))),
        settings=_settings,
        memory=lambda scene: _memory_for(fusion_of(), scene, config["max_disparity"]),
        palette=STATUS_PALETTE,
        shown_as="middlebury-v2",
        truth_kinds=(StereoScene,),
    )  # fmt: skip
    return batch, _find_scenes(pairs, coding, run, maps)


def prepare_judgment(
    maps: str,
    witnesses: Sequence[str],
    right_maps: str | None,
    pairs: PairOptions,
    coding: CodingOptions,
    run: ScoredRunOptions,
    max_disparity: str | None,
    within: float,
    measures: Sequence[str],
    threshold: float | None,
) -> tuple[Batch[MapsScene], list[MapsScene], ScoredRunOptions]:
    """Return the batch of ``confidence``, the pairs with their maps, and the options without a share in ``--keep``."""
    share = _share(run.keep)
    if share is not None and threshold is not None:
        raise ConfigError("--keep SHARE and --threshold exclude each other")
    try:
        names = list(judge_of(_checked_within(within), measures).measures)
    except ConfigError as error:
        raise ConfigError(str(error).replace("measures: ", "--measure: ")) from None
    config = ConfidenceOptions(
        max_disparity=_largest(max_disparity), within=within, keep=share, threshold=threshold, measures=names
    )
    batch = Batch(
        command="confidence",
        config=config,
        compute=_JudgeMaps(config),
        columns=(SIZE, Column("density", percent("density")), Column("expected right", percent("expected_right")),
                 Column("hidden", percent("hidden"))),
        settings=_settings,
        memory=lambda scene: _memory_for(judge_of(), scene, config["max_disparity"]),
        palette=STATUS_PALETTE,
        shown_as="middlebury-v2",
        truth_kinds=(StereoScene,),
    )  # fmt: skip
    scenes = _find_scenes(pairs, coding, run, [maps], witnesses, [right_maps] if right_maps else [])
    return batch, scenes, run if share is None else replace(run, keep=None)


def _share(text: str | None) -> float | None:
    """Return ``--keep`` as a share; None where it is the names of files."""
    try:
        share = float(text or "")
    except ValueError:
        return None
    if not 0 < share <= 1:
        raise ConfigError(f"--keep: expected a share above 0 and up to 1, or names of files (got {text!r})")
    return share


def _settings(scene: MapsScene) -> dict[str, str]:
    """Return by what the maps are read, and the range of the scene."""
    maps = scene.maps if scene.right_map is None else (*scene.maps, scene.right_map)
    coding = ", ".join(f"{one.scale} {one.invalid}" for one in maps)
    return {"max_disparity": str(scene.max_disparity), "coding": coding}


@dataclass(frozen=True)
class _FuseMaps:
    """Fuses the maps of one scene."""

    config: FuseMapsOptions

    def __call__(self, scene: MapsScene, folder: Path, memory: int) -> Outcome:
        config, clock = self.config, Clock()
        clock.start("load")
        pair = scene.load()
        maps = {one.run: _loaded(one, pair.shape) for one in scene.maps}
        clock.start("other")
        method = fusion_of(config["within"], config["surfaces"])
        found = fused(method, pair, maps, config["max_disparity"] or scene.max_disparity, memory)
        clock.include(found.seconds)
        clock.start("save")
        found.save(folder)
        columns = {
            "width": pair.shape[1],
            "height": pair.shape[0],
            "max_disparity": found.search.max_disparity,
            "maps": len(maps),
            "expected_right": round(float(found.confidence["probability"].mean()), 6),
            "measured": round(float(np.mean(found.measured)), 6),
        }
        absent = [f"no map of {run}: fused without it" for run in scene.absent]
        return Outcome(columns, clock.seconds, [*absent, *found.warnings])


@dataclass(frozen=True)
class _JudgeMaps:
    """Judges the map of one scene."""

    config: ConfidenceOptions

    def __call__(self, scene: MapsScene, folder: Path, memory: int) -> Outcome:
        config, clock = self.config, Clock()
        clock.start("load")
        method, top = judge_of(config["within"], config["measures"]), config["max_disparity"] or scene.max_disparity
        if scene.right is None:
            if len(scene.maps) > 1:
                raise InputError(f"{scene.left.parent}: no right image, without which there are no witnesses")
            left = read_image(scene.left)
            shape, values = left.shape[:2], _loaded(scene.maps[0], left.shape[:2])
            clock.start("other")
            found = judge_by_one_view(method, left, values, top)
        else:
            pair = scene.load()
            shape, maps = pair.shape, {one.run: _loaded(one, pair.shape) for one in scene.maps}
            right = None if scene.right_map is None else _loaded(scene.right_map, pair.shape)
            clock.start("other")
            found = judge(method, pair, maps, top, right, memory)
        clock.include(found.seconds)
        clock.start("save")
        found.save(folder, config["keep"], config["threshold"])
        known = np.isfinite(found.values)
        hidden = (found.status & int(Status.OCCLUDED | Status.OUT_OF_RANGE)) != 0
        columns = {
            "width": shape[1],
            "height": shape[0],
            "max_disparity": found.max_disparity,
            "density": round(float(np.isfinite(found.kept(config["keep"], config["threshold"])).mean()), 6),
            "expected_right": round(float(found.probability[known].mean()), 6) if known.any() else None,
            "hidden": round(float(hidden.mean()), 6),
        }
        absent = [f"no map of {run}: judged without it" for run in scene.absent]
        return Outcome(columns, clock.seconds, [*absent, *found.warnings])


def _find_scenes(
    pairs: PairOptions,
    coding: CodingOptions,
    run: RunOptions,
    first: Sequence[str],
    others: Sequence[str] = (),
    right: Sequence[str] = (),
) -> list[MapsScene]:
    """Return the scenes that the command line names, with their maps.

    Parameters
    ----------
    first : places of the runs of which a scene needs one map at least
    others : places of further runs, whose maps may be absent
    right : place of the run with maps of the right views; none or one

    Raises
    ------
    ConfigError, InputError
        As :func:`depthcli.commands._scenes.find_scenes`; no such run, or several files may be its maps.
    """
    places = find_runs([*first, *others])
    own = dict(list(places.items())[: len(first)])
    rights = find_runs(right) if right else {}
    coded = {**rights, **places}
    pattern, patterns = by_run("--pattern", coding.pattern or [], coded, pattern_of)
    scale, scales = by_run("--scale", coding.scale or [], coded, positive)
    invalid, invalids = by_run("--invalid", coding.invalid or [], coded, float)
    scenes = find_scenes((StereoScene,), pairs, run)
    short = [scene.name.rpartition("/")[2] for scene in scenes]
    names = {
        scene.name: names_in_run(scene.name, pairs.input and local(pairs.input), short.count(name) == 1)
        for scene, name in zip(scenes, short, strict=True)
    }
    known: MapFiles = DisparityFiles()
    options = {
        name: MapNaming(patterns.get(name) or pattern or "", scales.get(name, scale), invalids.get(name, invalid))
        for name in coded
    }
    for name, place in places.items():
        if os.path.isfile(place) and len(scenes) > 1:
            raise ConfigError(f"{place}: one map for {len(scenes)} scenes; give the folder of their maps")
        options[name] = _recognized(name, place, options[name], scenes, names, run.reporter)
    right_files = MapFiles(("{scene}/disp_right", "disp_1/{scene}", "{scene}_right", "{scene}"), known.suffixes)
    found = []
    for scene in scenes:
        maps, absent = [], []
        for name, place in places.items():
            path = _file(place, options[name].files(known), names[scene.name])
            if path is None:
                absent.append(name)
            else:
                maps.append(GivenMap(name, path, options[name].scale, options[name].invalid))
        problem = ""
        if not any(one.run in own for one in maps):
            where = ", ".join(str(place) for place in own.values())
            problem = f"{where}: no map of scene {scene.name}{known.searched(names[scene.name])}"
        other = None
        for name, place in rights.items():
            how = MapNaming(patterns.get(name, ""), options[name].scale, options[name].invalid)
            path = _file(place, how.files(right_files), names[scene.name])
            if path is None:
                absent.append(f"{name} (right view)")
            else:
                other = GivenMap(name, path, how.scale, how.invalid)
        found.append(MapsScene.of(scene, tuple(maps), other, tuple(absent), problem))
    return found


def _largest(text: str | None) -> int | None:
    """Return the largest disparity that the command line gives, or None; ConfigError for what is no number."""
    if text is None:
        return None
    if not text.isdigit() or not 1 <= int(text) <= 16383:
        raise ConfigError(f"--max-disparity: expected a whole number from 1 to 16383 (got {text!r})")
    return int(text)


def _checked_within(within: float) -> float:
    if not 0.25 <= within <= 8:
        raise ConfigError(f"--within: expected 0.25 to 8 pixels (got {within:g})")
    return within


def _file(place: Path, files: MapFiles, names: Sequence[str]) -> Path | None:
    return place if os.path.isfile(place) else files.find(place, names)


def _recognized(
    run: str,
    place: Path,
    options: MapNaming,
    scenes: Sequence[StereoScene],
    names: dict[str, list[str]],
    reporter: Reporter,
) -> MapNaming:
    # The options with the pattern of the maps of a run that holds none under a usual name.
    if not os.path.isdir(place) or read_report(place):
        return options
    usable = {scene.name: scene for scene in scenes if not scene.problem}
    protocol = protocols.load("middlebury-v2")()

    def fits(name: str, path: Path, tried: MapNaming) -> bool:
        with collected_warnings():
            try:
                shape = GivenMap(run, path, tried.scale, tried.invalid).load().shape
                return shape == image_size(usable[name].left)
            except DepthcliError:
                return False

    found = recognized(run, place, options, {name: (protocol.files, names[name]) for name in usable}, fits)
    if found != options:
        reporter.info(f"{run}: taken as its maps: {found.pattern} (--pattern says otherwise)")
    return found


def _memory_for(method: UsesNetworks, scene: MapsScene, max_disparity: int | None) -> int | None:
    """Estimate the memory for a scene by the left image's size; None where the maps give the range."""
    top = max_disparity or scene.max_disparity
    return None if top is None else method.peak_bytes(image_size(scene.left), top, len(scene.maps))


def _loaded(one: GivenMap, shape: tuple[int, int]) -> NDArray[np.float32]:
    """Return a map; InputError where it cannot be read or has another size than the images."""
    values = one.load()
    if values.shape != shape:
        raise InputError(
            f"{one.path}: {values.shape[1]} x {values.shape[0]}, but the images are {shape[1]} x {shape[0]}"
        )
    return values
