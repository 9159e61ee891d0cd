"""Find and decode the disparity maps that ``confidence`` and ``fuse maps`` take."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from depthcli.commands._options import CodingOptions, PairOptions, RunOptions
from depthcli.commands._scenes import find_scenes
from depthcli.core.errors import ConfigError, DepthcliError, InputError
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
from depthcli.io.formats.images import image_size
from depthcli.io.scenes import GivenMap, MapsScene, Scene, StereoScene
from depthcli.io.scenes.pairs import PAIRS
from depthcli.io.scenes.places import local
from depthcli.methods.given_maps import peak_bytes
from depthcli.problems.problem import SceneJob
from depthcli.run.console import Reporter
from depthcli.run.records import RECORD_FILE
from depthcli.run.report import read_report

_RIGHT_FILES = MapFiles(("{scene}/disp_right", "disp_1/{scene}", "{scene}_right", "{scene}"), DisparityFiles().suffixes)


def largest(text: str | None) -> int | None:
    """Return the largest disparity that the command line gives, or None; ConfigError if it is no number."""
    if text is None:
        return None
    if not text.isdigit() or not 1 <= int(text) <= 16383:
        raise ConfigError(f"--max-disparity: expected a whole number from 1 to 16383 (got {text!r})")
    return int(text)


@dataclass(frozen=True)
class GivenMaps(SceneJob[MapsScene]):
    """Common base of ``confidence`` and ``fuse maps``; ``config`` has the options, None for one not given."""

    n_added: ClassVar[int] = 0
    """Number of maps that are compared with the given ones."""

    config: Mapping[str, Any]

    def truth_scenes(self, scenes: Sequence[MapsScene]) -> Sequence[Scene]:
        """Return the pairs, which can be used without their maps."""
        return [scene.pair for scene in scenes]

    def settings(self, scene: MapsScene) -> dict[str, str]:
        """Return the readers of the maps, and the range of the scene."""
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


def find_maps(
    pairs: PairOptions,
    coding: CodingOptions,
    options: RunOptions,
    first: Sequence[str],
    others: Sequence[str] = (),
    right: str | None = None,
) -> list[MapsScene]:
    """Return the scenes that the command line names, with their maps.

    A scene needs a map of at least one of the runs ``first``; maps of the runs ``others``, and of the right views by
    the run ``right``, may be absent. ConfigError or InputError if such a run or a scene is missing, or several
    files may be a run's maps.
    """
    places, right_places = find_runs([*first, *others]), find_runs([right]) if right else {}
    of_all, own = given_naming({**right_places, **places}, "--pattern", coding.pattern, coding.scale, coding.invalid)
    of_rights = replace(of_all, pattern="")
    runs = [_Run(name, place, DisparityFiles(), own[name].over(of_all)) for name, place in places.items()]
    rights = [_Run(name, place, _RIGHT_FILES, own[name].over(of_rights)) for name, place in right_places.items()]
    scenes = find_scenes(PAIRS, pairs, options)
    names = names_in_run([scene.name for scene in scenes], pairs.input and local(pairs.input))
    runs = [run.recognized(scenes, names, options.reporter) for run in runs]
    made = []
    for scene in scenes:
        of_scene = names[scene.name]
        maps, right_maps = ([run.map_of(of_scene) for run in each] for each in (runs, rights))
        absent = [run.name for run, one in zip(runs, maps, strict=True) if one is None]
        absent += [f"{run.name} (right view)" for run, one in zip(rights, right_maps, strict=True) if one is None]
        problem = scene.problem
        if not problem and not any(maps[: len(first)]):
            where = ", ".join(str(run.place) for run in runs[: len(first)])
            problem = f"{where}: no map of scene {scene.name}{DisparityFiles().searched(of_scene)}"
        there, right_map = tuple(filter(None, maps)), next(iter(right_maps), None)
        fields = {"left": scene.folder, **vars(scene), "problem": problem}  # an unusable folder has no left image
        made.append(MapsScene(**fields, pair=scene, maps=there, right_map=right_map, absent=tuple(absent)))
    return made


@dataclass(frozen=True)
class _Run:
    """Maps of one view, by one program: a folder of them, or one map."""

    name: str
    place: Path
    files: MapFiles  # usual places of maps of the view
    naming: MapNaming

    def map_of(self, names: Sequence[str]) -> GivenMap | None:
        """Return the map of a scene that may have these names, or None."""
        single = os.path.isfile(self.place)
        path = self.place if single else self.naming.files(self.files).find(self.place, names)
        if path is None:
            return None
        status = path.parent / "status.png"
        is_own = status.is_file() and (path.parent / RECORD_FILE).is_file()  # maps of other programs have no such file
        return GivenMap(self.name, path, self.naming.scale, self.naming.invalid, status if is_own else None)

    def recognized(self, scenes: Sequence[StereoScene], names: Mapping[str, Sequence[str]], reporter: Reporter) -> _Run:
        """Return the run with the pattern of its maps, if another program made them and none has a usual name."""
        if os.path.isfile(self.place):
            if len(scenes) > 1:
                raise ConfigError(f"{self.place}: one map for {len(scenes)} scenes; give the folder of their maps")
            return self
        if read_report(self.place):
            return self
        usable = {scene.name: scene for scene in scenes if not scene.problem}

        def fits(name: str, path: Path, tried: MapNaming) -> bool:
            with collected_warnings(), contextlib.suppress(DepthcliError):
                shape = _read_map(GivenMap(self.name, path, tried.scale, tried.invalid)).shape
                return shape == image_size(usable[name].left)
            return False

        usual = protocols.load("middlebury-v2")().files
        of_scenes = {name: (usual, names[name]) for name in usable}
        found = recognized(self.name, self.place, self.naming, of_scenes, fits)
        if found != self.naming:
            reporter.info(f"{self.name}: taken as its maps: {found.pattern} (--pattern sets others)")
        return replace(self, naming=found)


def loaded(one: GivenMap, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Return a map; InputError where it cannot be read or has another size than the images."""
    values = _read_map(one)
    if values.shape != shape:
        height, width = values.shape
        raise InputError(f"{one.path}: {width} x {height}, but the images are {shape[1]} x {shape[0]}")
    return values


def _read_map(one: GivenMap) -> NDArray[np.float32]:
    """Return a map, (H, W) float32, pixels, NaN = no value.

    If no option names the value that means none, a constant at or below 0 that is alone there means none in maps of
    other programs, with a warning.
    """
    values = read_disparity(one.path, one.scale)
    if one.invalid is not None:
        values[read_plane(one.path) == np.float32(one.invalid)] = np.nan
    elif (one.path.parent / "record.json").is_file():  # runs of this program mark what has no value
        pass
    elif (constant := lone_constant(values)) is not None:
        marked = values == np.float32(constant)
        values[marked] = np.nan
        share = f"{100 * np.mean(marked):.3g} % of the pixels are {constant:g}"
        warn(f"{shown(one.path)}: {share}: taken as no value (--invalid nan keeps them)")
    return values
