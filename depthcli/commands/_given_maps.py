"""What ``confidence`` and ``fuse maps`` compute of disparity maps made before, which are found and decoded first."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from depthcli.api.maps import fused, judged, measures_named
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
    find_runs,
    given_naming,
    names_in_run,
    recognized,
)
from depthcli.io.formats.disparity import lone_constant, read_disparity, read_plane
from depthcli.io.formats.files import collected_warnings, shown, warn
from depthcli.io.formats.images import image_size, read_image
from depthcli.io.formats.pictures import STATUS_PALETTE
from depthcli.io.inputs import local
from depthcli.io.layouts.stereo import PAIRS
from depthcli.io.scenes import GivenMap, MapsScene, Scene, StereoScene
from depthcli.io.stereo_pairs import load_pair
from depthcli.methods.given_maps import peak_bytes
from depthcli.methods.given_maps.fusion import MAX_MAPS, N_ADDED
from depthcli.run.batch import Batch, Outcome
from depthcli.run.console import SIZE, number, percent
from depthcli.run.json_csv import share
from depthcli.run.report import read_report


def prepare_fusion(
    maps: Sequence[str],
    pairs: RangeOptions,
    coding: CodingOptions,
    run: RunOptions,
    within: float,
    surfaces: bool,
    settings: Sequence[str] | None,
) -> tuple[FuseMaps, list[MapsScene]]:
    """Return the batch of ``fuse maps``, and the pairs with their maps."""
    if not 1 <= len(maps) <= MAX_MAPS:
        raise ConfigError(f"--maps: give 1 to {MAX_MAPS} runs or maps (got {len(maps)})")
    unused = [name for name in ("calibration", "unit", "min_disparity") if getattr(pairs, name) is not None]
    if unused or settings:
        raise ConfigError(f"--{(unused or ['set'])[0].replace('_', '-')} does not go with fuse maps")
    config = {"max_disparity": _largest(pairs.max_disparity), "within": within, "surfaces": surfaces}
    return FuseMaps(config), _find_scenes(pairs, coding, run, maps)


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
) -> tuple[Confidence, list[MapsScene], ScoredRunOptions]:
    """Return the batch of ``confidence``, the pairs with their maps, and the options without a share in ``--keep``."""
    try:
        share = float(run.keep or "")
    except ValueError:  # names of files
        share = None
    if share is not None and not 0 < share <= 1:
        raise ConfigError(f"--keep: expected a share above 0 and up to 1, or names of files (got {run.keep!r})")
    if share is not None and threshold is not None:
        raise ConfigError("--keep SHARE and --threshold exclude each other")
    try:
        names = measures_named(measures)
    except ConfigError as error:
        raise ConfigError(str(error).replace("measures: ", "--measure: ")) from None
    config: dict[str, Any] = {"max_disparity": _largest(max_disparity), "within": within}
    config |= {"keep": share, "threshold": threshold, "measures": names}
    scenes = _find_scenes(pairs, coding, run, [maps], witnesses, right_maps)
    return Confidence(config), scenes, run if share is None else replace(run, keep=None)


def _largest(text: str | None) -> int | None:
    """Return the largest disparity that the command line gives, or None; ConfigError for what is no number."""
    if text is None:
        return None
    if not text.isdigit() or not 1 <= int(text) <= 16383:
        raise ConfigError(f"--max-disparity: expected a whole number from 1 to 16383 (got {text!r})")
    return int(text)


@dataclass(frozen=True)
class _GivenMaps(Batch[MapsScene]):
    """What both have in common; ``config`` holds the options, None where one is not given."""

    palette = STATUS_PALETTE
    shown_as = "middlebury-v2"
    n_added: ClassVar[int] = 0
    """Number of maps that are compared beside the given ones."""

    config: Mapping[str, Any]

    def truth_scenes(self, scenes: Sequence[MapsScene]) -> Sequence[Scene]:
        """Return the pairs, which can be used without their maps."""
        return [scene.pair for scene in scenes]

    def settings(self, scene: MapsScene) -> dict[str, str]:
        """Return by what the maps are read, and the range of the scene."""
        maps = scene.maps if scene.right_map is None else (*scene.maps, scene.right_map)
        coding = ", ".join(f"{one.scale} {one.invalid}" for one in maps)
        return {"max_disparity": str(scene.max_disparity), "coding": coding}

    def memory(self, scene: MapsScene) -> int | None:
        """Estimate by the left image's size; None where the maps give the range."""
        top = self.max_disparity(scene)
        return None if top is None else peak_bytes(image_size(scene.left), top, len(scene.maps) + self.n_added)

    def max_disparity(self, scene: MapsScene) -> int | None:
        """Return the largest disparity that the options or the scene give."""
        given: int | None = self.config["max_disparity"]
        return given or scene.max_disparity


@dataclass(frozen=True)
class FuseMaps(_GivenMaps):
    """Fuses the maps of scenes."""

    command = "fuse-maps"
    n_added = N_ADDED
    columns = (SIZE, number("maps", "{}"), *map(percent, ("expected_right", "measured")))

    def compute(self, scene: MapsScene, folder: Path, memory: int) -> Outcome:
        """Load a pair and its maps, fuse them, save."""
        clock = Clock()
        clock.start("load")
        pair = load_pair(scene)
        maps = {one.run: _loaded(one, pair.shape) for one in scene.maps}
        clock.start("other")
        config = self.config
        found = fused(pair, maps, self.max_disparity(scene), config["within"], config["surfaces"], memory)
        clock.include(found.seconds)
        clock.start("save")
        found.save(folder)
        columns = {
            "width": pair.shape[1],
            "height": pair.shape[0],
            "max_disparity": found.search.max_disparity,
            "maps": len(maps),
            "expected_right": share(found.confidence["probability"]),
            "measured": share(found.measured),
        }
        absent = [f"no map of {run}: fused without it" for run in scene.absent]
        return Outcome(columns, clock.seconds, [*absent, *found.warnings])


@dataclass(frozen=True)
class Confidence(_GivenMaps):
    """Judges the first map of scenes."""

    command = "confidence"
    columns = (SIZE, *map(percent, ("density", "expected_right", "hidden")))

    def compute(self, scene: MapsScene, folder: Path, memory: int) -> Outcome:
        """Load a pair and its maps, judge the first, save it with its confidence."""
        config, clock = self.config, Clock()
        clock.start("load")
        if scene.right is None and len(scene.maps) > 1:
            raise InputError(f"{scene.left.parent}: no right image, without which there are no witnesses")
        images = read_image(scene.left) if scene.right is None else load_pair(scene)
        shape = (images.shape[0], images.shape[1])
        maps = {one.run: _loaded(one, shape) for one in scene.maps}
        right = None if scene.right is None or scene.right_map is None else _loaded(scene.right_map, shape)
        clock.start("other")
        top = self.max_disparity(scene)
        found = judged(images, maps, top, config["within"], config["measures"], right, memory)
        clock.include(found.seconds)
        clock.start("save")
        found.save(folder, config["keep"], config["threshold"])
        known = np.isfinite(found.values)
        hidden = (found.status & int(Status.OCCLUDED | Status.OUT_OF_RANGE)) != 0
        columns = {
            "width": found.values.shape[1],
            "height": found.values.shape[0],
            "max_disparity": found.max_disparity,
            "density": share(np.isfinite(found.kept(config["keep"], config["threshold"]))),
            "expected_right": share(found.probability[known]) if known.any() else None,
            "hidden": share(hidden),
        }
        absent = [f"no map of {run}: judged without it" for run in scene.absent]
        return Outcome(columns, clock.seconds, [*absent, *found.warnings])


def _loaded(one: GivenMap, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Return a map; InputError where it cannot be read or has another size than the images."""
    values = _read_map(one)
    if values.shape != shape:
        raise InputError(
            f"{one.path}: {values.shape[1]} x {values.shape[0]}, but the images are {shape[1]} x {shape[0]}"
        )
    return values


def _read_map(one: GivenMap) -> NDArray[np.float32]:
    """Return a map, (H, W) float32, pixels, NaN = no value.

    Where nothing is said about what stands for no value, a constant at or below 0 that stands alone does, in maps of
    other programs; a warning says so.
    """
    values = read_disparity(one.path, one.scale)
    if one.invalid is not None:
        values[read_plane(one.path) == np.float32(one.invalid)] = np.nan
    elif not (one.path.parent / "record.json").is_file():  # runs of this program mark what has no value
        constant = lone_constant(values)
        if constant is not None:
            marked = values == np.float32(constant)
            values[marked] = np.nan
            warn(
                f"{shown(one.path)}: {100 * np.mean(marked):.3g} % of the pixels are {constant:g}: taken as no value "
                "(--invalid nan keeps them)"
            )
    return values


def _find_scenes(
    pairs: PairOptions,
    coding: CodingOptions,
    run: RunOptions,
    first: Sequence[str],
    others: Sequence[str] = (),
    right: str | None = None,
) -> list[MapsScene]:
    """Return the scenes that the command line names, with their maps.

    Parameters
    ----------
    first : places of the runs of which a scene needs one map at least
    others : places of further runs, whose maps may be absent
    right : place of the run with maps of the right views

    Raises
    ------
    ConfigError, InputError
        As :func:`depthcli.commands._scenes.find_scenes`; no such run, or several files may be its maps.
    """
    places, rights = find_runs([*first, *others]), find_runs([right]) if right else {}
    of_all, own = given_naming({**rights, **places}, "--pattern", coding.pattern, coding.scale, coding.invalid)
    naming = {name: own[name].over(of_all) for name in places}
    right_naming = {name: own[name].over(replace(of_all, pattern="")) for name in rights}
    scenes = find_scenes(PAIRS, pairs, run)
    names = names_in_run([scene.name for scene in scenes], pairs.input and local(pairs.input))
    for name, place in places.items():
        if os.path.isfile(place):
            if len(scenes) > 1:
                raise ConfigError(f"{place}: one map for {len(scenes)} scenes; give the folder of their maps")
        elif not read_report(place):  # maps of another program, which may have names of their own
            found = _recognized(name, place, naming[name], scenes, names)
            if found != naming[name]:
                run.reporter.info(f"{name}: taken as its maps: {found.pattern} (--pattern says otherwise)")
            naming[name] = found
    files: MapFiles = DisparityFiles()
    right_files = MapFiles(("{scene}/disp_right", "disp_1/{scene}", "{scene}_right", "{scene}"), files.suffixes)
    made = []
    for scene in scenes:
        of_scene = names[scene.name]
        maps = {name: _map_of(name, place, naming[name], files, of_scene) for name, place in places.items()}
        other = {name: _map_of(name, at, right_naming[name], right_files, of_scene) for name, at in rights.items()}
        absent = [name for name, one in maps.items() if one is None]
        absent += [f"{name} (right view)" for name, one in other.items() if one is None]
        problem = ""
        if not any(list(maps.values())[: len(first)]):
            where = ", ".join(map(str, list(places.values())[: len(first)]))
            problem = f"{where}: no map of scene {scene.name}{files.searched(of_scene)}"
        there = tuple(one for one in maps.values() if one is not None)
        own_fields = {**vars(scene), "problem": scene.problem or problem}
        right_map = next(iter(other.values()), None)
        made.append(MapsScene(**own_fields, pair=scene, maps=there, right_map=right_map, absent=tuple(absent)))
    return made


def _map_of(run: str, place: Path, naming: MapNaming, files: MapFiles, names: Sequence[str]) -> GivenMap | None:
    """Return the map of a scene with such names in a run, or the one that ``place`` is; None where there is none."""
    path = place if os.path.isfile(place) else naming.files(files).find(place, names)
    return None if path is None else GivenMap(run, path, naming.scale, naming.invalid)


def _recognized(
    run: str, place: Path, naming: MapNaming, scenes: Sequence[StereoScene], names: Mapping[str, Sequence[str]]
) -> MapNaming:
    """Return the naming with the pattern of the maps of a run that holds none under a usual name."""
    usable = {scene.name: scene for scene in scenes if not scene.problem}

    def fits(name: str, path: Path, tried: MapNaming) -> bool:
        with collected_warnings():
            try:
                shape = _read_map(GivenMap(run, path, tried.scale, tried.invalid)).shape
                return shape == image_size(usable[name].left)
            except DepthcliError:
                return False

    usual = protocols.load("middlebury-v2")().files
    return recognized(run, place, naming, {name: (usual, names[name]) for name in usable}, fits)
