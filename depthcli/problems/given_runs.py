"""Find the maps of given runs, in folders of depthcli or of other programs, for ``confidence`` and ``fuse maps``."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from depthcli.core.errors import ConfigError, DepthcliError
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
from depthcli.io.formats.disparity import read_plane, scale_of
from depthcli.io.formats.files import collected_warnings, is_of_a_run
from depthcli.io.scenes import GivenMap, MapsScene, StereoScene
from depthcli.io.stereo_pairs import view_size
from depthcli.run.console import Reporter
from depthcli.run.records import read_report

_RIGHT_FILES = MapFiles(("{scene}/disp_right", "disp_1/{scene}", "{scene}_right", "{scene}"), DisparityFiles().suffixes)


def with_maps(
    scenes: Sequence[StereoScene],
    place: Path | None,
    coding: tuple[Sequence[str] | None, Sequence[str] | None, Sequence[str] | None],
    reporter: Reporter,
    first: Sequence[str],
    others: Sequence[str] = (),
    right: str | None = None,
) -> list[MapsScene]:
    """Return pairs with their maps.

    A scene needs a map from at least one of the runs ``first``. Maps from the runs ``others``, and right views' maps
    from the run ``right``, are optional. Raise ConfigError or InputError if a run or scene is missing, or several
    files may be a run's map.
    """
    places, right_places = find_runs([*first, *others]), find_runs([right]) if right else {}
    of_all, own = given_naming({**right_places, **places}, *coding)
    of_all = replace(of_all, any_scale=len(places) == 1)
    of_rights = replace(of_all, pattern="")
    names = names_in_run([scene.name for scene in scenes], place)
    runs = [_GivenRun(name, place, DisparityFiles(), own[name].over(of_all)) for name, place in places.items()]
    runs = [run.recognized(scenes, names, reporter) for run in runs]
    rights = [_GivenRun(name, place, _RIGHT_FILES, own[name].over(of_rights)) for name, place in right_places.items()]
    made = []
    for scene in scenes:
        of_scene = names[scene.name]
        maps, right_maps = ([run.map_of(of_scene) for run in each] for each in (runs, rights))
        absent = [run.name for run, one in zip(runs, maps, strict=True) if one is None]
        absent += [f"{run.name} (right view)" for run, one in zip(rights, right_maps, strict=True) if one is None]
        there, problem = tuple(filter(None, maps)), scene.problem
        if not problem and not any(maps[: len(first)]):
            where = ", ".join(str(run.place) for run in runs[: len(first)])
            problem = f"{where}: no map of scene {scene.name}{DisparityFiles().searched(of_scene)}"
        right_map = next(iter(right_maps), None)
        fields = {"left": scene.folder, **vars(scene), "problem": problem}  # an unusable folder has no left image
        made.append(MapsScene(**fields, pair=scene, maps=there, right_map=right_map, absent=tuple(absent)))
    return made


@dataclass(frozen=True)
class _GivenRun:
    """One program's maps of one view: a folder, or a single map."""

    name: str
    place: Path
    files: MapFiles  # usual paths of the view's maps
    naming: MapNaming

    def map_of(self, names: Sequence[str]) -> GivenMap | None:
        """Return the map of a scene, which may have any of these names, or None."""
        path = self.place if os.path.isfile(self.place) else self.naming.files(self.files).find(self.place, names)
        if path is None:
            return None
        status = path.parent / "status.png"
        is_own = status.is_file() and is_of_a_run(path)  # other programs write no record
        scale = scale_of(path, self.naming.scale, self.naming.any_scale)
        return GivenMap(self.name, path, scale, self.naming.invalid, status if is_own else None)

    def recognized(
        self, scenes: Sequence[StereoScene], names: Mapping[str, Sequence[str]], reporter: Reporter
    ) -> _GivenRun:
        """Return the run with the recognized pattern of its maps, if no map of another program has a usual name."""
        if os.path.isfile(self.place):
            if len(scenes) > 1:
                raise ConfigError(f"{self.place}: one map for {len(scenes)} scenes; give the folder of their maps")
            return self
        if read_report(self.place):
            return self
        usable = {scene.name: scene for scene in scenes if not scene.problem}

        def fits(name: str, path: Path, _: MapNaming) -> bool:
            with collected_warnings(), contextlib.suppress(DepthcliError):
                return read_plane(path).shape == view_size(usable[name])
            return False

        usual = protocols.load("middlebury-v2")().files
        of_scenes = {name: (usual, names[name]) for name in usable}
        found = recognized(self.name, self.place, self.naming, of_scenes, fits)
        if found != self.naming:
            reporter.info(f"{self.name}: taken as its maps: {found.pattern} (--pattern sets others)")
        return replace(self, naming=found)
