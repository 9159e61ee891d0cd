"""Disparity maps of other runs as the input of a command: which file is whose, and how it is coded."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from depthcli.commands._old_batch import BatchCommand
from depthcli.core.errors import ConfigError, DepthcliError, InputError
from depthcli.core.option import Option
from depthcli.io.inputs import local
from depthcli.io.scenes import Scene
from depthcli.io.scenes.given_maps import GivenMap, MapsScene
from depthcli.io.scenes.stereo import StereoScene
from depthcli.run.command import ConfigT, Values
from depthcli.run.console import Reporter

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from depthcli.evaluation.map_files import MapFiles, MapOptions
    from depthcli.io.formats.pictures import Palette
    from depthcli.methods.given_maps import UsesNetworks

PAIR_OPTIONS = (
    *(option for option in StereoScene.options if option.name in ("left", "right")),
    Option("max_disparity", str, "Largest disparity compared with. Default: the scene's, else the maps'.", "N"),
)
CODING = (
    Option("pattern", str, "Path of a map in its folder, '{scene}/a.tiff'. Of one run: NAME=...", "PATTERN",
           repeatable=True, group="Input"),
    Option("scale", str, "Codes per pixel of integer files. Of one run: NAME=...", "CODES", repeatable=True,
           group="Input"),
    Option("invalid", str, "Value that means none, or nan. Of one run: NAME=...", "VALUE", repeatable=True,
           group="Input"),
)  # fmt: skip


class MapsCommand(BatchCommand[ConfigT, MapsScene]):
    """A command that goes through pairs whose maps were made before."""

    shown_as: ClassVar[str] = "middlebury-v2"

    def truth_kinds(self, scenes: Sequence[MapsScene]) -> tuple[type[Scene], ...]:
        """Return stereo pairs, which the scenes are without their maps."""
        return (StereoScene,)

    def settings(self, config: ConfigT, scene: MapsScene) -> dict[str, str]:
        """Return by what the maps are read, and the range of the scene."""
        maps = scene.maps if scene.right_map is None else (*scene.maps, scene.right_map)
        coding = ", ".join(f"{one.scale} {one.invalid}" for one in maps)
        return {"max_disparity": str(scene.max_disparity), "coding": coding}

    def palette(self) -> Palette:
        from depthcli.io.formats.pictures import STATUS_PALETTE

        return STATUS_PALETTE


def find_map_scenes(
    values: Values, reporter: Reporter, first: Sequence[str], others: Sequence[str] = (), right: Sequence[str] = ()
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
    from depthcli.commands._runs import by_run, number_of, pattern_of, positive
    from depthcli.commands._scenes import find_scenes
    from depthcli.evaluation.map_files import DisparityFiles, MapFiles, MapOptions, find_runs, names_in_run

    places = find_runs([*first, *others])
    own = dict(list(places.items())[: len(first)])
    rights = find_runs(right) if right else {}
    coded = {**rights, **places}
    pattern, patterns = by_run("--pattern", values["pattern"] or [], coded, pattern_of)
    scale, scales = by_run("--scale", values["scale"] or [], coded, positive)
    invalid, invalids = by_run("--invalid", values["invalid"] or [], coded, number_of)
    scenes = find_scenes((StereoScene,), values, reporter)
    short = [scene.name.rpartition("/")[2] for scene in scenes]
    names = {
        scene.name: names_in_run(scene.name, values["input"] and local(values["input"]), short.count(name) == 1)
        for scene, name in zip(scenes, short, strict=True)
    }
    known: MapFiles = DisparityFiles()
    options = {
        run: MapOptions(patterns.get(run) or pattern or "", scales.get(run, scale), invalids.get(run, invalid))
        for run in coded
    }
    for run, place in places.items():
        if os.path.isfile(place) and len(scenes) > 1:
            raise ConfigError(f"{place}: one map for {len(scenes)} scenes; want the folder of their maps")
        options[run] = _recognized(run, place, options[run], scenes, names, reporter)
    right_files = MapFiles(("{scene}/disp_right", "disp_1/{scene}", "{scene}_right", "{scene}"), known.suffixes)
    found = []
    for scene in scenes:
        maps, absent = [], []
        for run, place in places.items():
            path = _file(place, options[run].files(known), names[scene.name])
            if path is None:
                absent.append(run)
            else:
                maps.append(GivenMap(run, path, options[run].scale, options[run].invalid))
        problem = ""
        if not any(one.run in own for one in maps):
            where = ", ".join(str(place) for place in own.values())
            problem = f"{where}: no map of scene {scene.name}{known.searched(names[scene.name])}"
        other = None
        for run, place in rights.items():
            coding = MapOptions(patterns.get(run, ""), options[run].scale, options[run].invalid)
            path = _file(place, coding.files(right_files), names[scene.name])
            if path is None:
                absent.append(f"{run} (right view)")
            else:
                other = GivenMap(run, path, coding.scale, coding.invalid)
        found.append(MapsScene.of(scene, tuple(maps), other, tuple(absent), problem))
    return found


def largest_of(values: Values) -> int | None:
    """Return the largest disparity that the command line gives, or None; ConfigError for what is no number."""
    text = values["max_disparity"]
    if text is None:
        return None
    if not text.isdigit() or not 1 <= int(text) <= 16383:
        raise ConfigError(f"--max-disparity: want a whole number from 1 to 16383 (got {text!r})")
    return int(text)


def threshold_of(values: Values) -> float:
    """Return ``--within``; ConfigError where it is out of bounds."""
    within: float = values["within"]
    if not 0.25 <= within <= 8:
        raise ConfigError(f"--within: want 0.25 to 8 pixels (got {within:g})")
    return within


def _file(place: Path, files: MapFiles, names: Sequence[str]) -> Path | None:
    return place if os.path.isfile(place) else files.find(place, names)


def _recognized(
    run: str,
    place: Path,
    options: MapOptions,
    scenes: Sequence[StereoScene],
    names: dict[str, list[str]],
    reporter: Reporter,
) -> MapOptions:
    # The options with the pattern of the maps of a run that holds none under a usual name.
    from depthcli.evaluation import protocols
    from depthcli.evaluation.map_files import recognized
    from depthcli.io.formats.files import collected_warnings
    from depthcli.io.formats.images import image_size
    from depthcli.run.report import read_report

    if not os.path.isdir(place) or read_report(place):
        return options
    usable = {scene.name: scene for scene in scenes if not scene.problem}
    protocol = protocols.load("middlebury-v2")()

    def fits(name: str, path: Path, tried: MapOptions) -> bool:
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


def memory_for(method: UsesNetworks, scene: MapsScene, max_disparity: int | None) -> int | None:
    """Estimate the memory for a scene by the left image's size; None where the maps give the range."""
    from depthcli.io.formats.images import image_size

    top = max_disparity or scene.max_disparity
    return None if top is None else method.peak_bytes(image_size(scene.left), top, len(scene.maps))


def loaded(one: GivenMap, shape: tuple[int, int]) -> NDArray[np.float32]:
    """Return a map; InputError where it cannot be read or has another size than the images."""
    values = one.load()
    if values.shape != shape:
        raise InputError(
            f"{one.path}: {values.shape[1]} x {values.shape[0]}, but the images are {shape[1]} x {shape[0]}"
        )
    return values
