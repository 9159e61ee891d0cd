"""The scenes that a command line names: a folder, a table of files, the files of a single scene, or maps of a run."""

from __future__ import annotations

import gc
import os
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import cast

from depthcli.commands._options import MapOptions, RunOptions, SceneOptions
from depthcli.core.errors import ConfigError, InputError
from depthcli.io.inputs import local
from depthcli.io.pairs import TABLE_SUFFIXES
from depthcli.io.scenes import Scene
from depthcli.io.scenes.maps import DisparityScene
from depthcli.io.scenes.stereo import StereoScene
from depthcli.io.walk import NoScenesError, chosen_scenes, discover_scenes, matches_any, scenes_with_files
from depthcli.run.batch import SceneT
from depthcli.run.console import Reporter
from depthcli.run.records import is_inside
from depthcli.run.report import read_report

_MAP = "disp_left.pfm"
_MIN_SCENES_TO_FREEZE = 1000  # scenes, whose objects take long to look through


def find_scenes(kinds: tuple[type[SceneT], ...], source: SceneOptions, run: RunOptions) -> list[SceneT]:
    """Return the scenes that ``--input``, or the options for the files of a single scene, name.

    Raises
    ------
    ConfigError
        Neither or both are given, or an option that does not go with them.
    InputError
        As :func:`depthcli.io.walk.discover_scenes`.
    """
    place, name, single = source.input, source.name, source.single_files
    files = {key: local(value) if isinstance(value, Path) else value for key, value in vars(source).items()}
    if named := next((scenes for kind in kinds if (scenes := kind.named(files))), []):
        if place is not None:
            raise ConfigError(f"--input and {single} exclude each other")
        if run.evaluate:
            raise ConfigError("--evaluate needs --input: a single scene has no ground truth")
        if name is None:
            return _chosen(named, source.patterns, "the command line")
        if len(named) > 1:
            raise ConfigError(f"--name is for a single scene, these are {len(named)}")
        return [replace(named[0], name=name)]
    if place is None:
        raise ConfigError(f"give --input DIR, or {single}")
    if name is not None:
        raise ConfigError(f"--name is for a single scene, given by {single}")
    if run.evaluate and os.path.isfile(local(place)):
        raise ConfigError(f"{place}: --evaluate needs a folder of scenes, with their ground truth")
    try:
        return scenes_at(place, kinds, source.layout, source.patterns, run.reporter)
    except NoScenesError as error:
        raise NoScenesError(f"{error}; give files of other names by {single}") from error


def scenes_at(
    place: Path, kinds: tuple[type[SceneT], ...], layout: str | None, patterns: Sequence[str], reporter: Reporter
) -> list[SceneT]:
    """Return the scenes of a folder, or those that a table of files lists."""
    if os.path.isfile(place) and place.suffix.lower() in TABLE_SUFFIXES:
        return _chosen(kinds[0].of_table(place), patterns, place)
    # Folders that cannot be read are among them as scenes with a ``problem``, which are reported and not computed.
    found = cast("list[SceneT]", discover_scenes(place, kinds, layout, patterns, reporter.info))
    if len(found) >= _MIN_SCENES_TO_FREEZE:
        gc.freeze()  # they stay to the end: no later search for garbage has to look at them
    return found


def _chosen(scenes: Sequence[SceneT], patterns: Sequence[str], place: Path | str) -> list[SceneT]:
    return cast("list[SceneT]", chosen_scenes(cast("Sequence[Scene]", scenes), patterns, place))


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
    return sorted([*found, *(_missing_map(run / name, name) for name in missing)], key=lambda scene: scene.name)


def _missing_map(folder: Path, name: str) -> DisparityScene:
    problem = f"{folder}: no {_MAP}, though the run's report lists the scene as done; run it again"
    return DisparityScene(name=name, folder=folder, disparity=folder / _MAP, problem=problem)


def _names_of_maps(run: Path, reported: Sequence[str], patterns: Sequence[str]) -> list[str]:
    if not os.path.isdir(run):
        raise InputError(f"{run}: no such run folder or map")
    names = {name for name in reported if os.path.isfile(run / name / _MAP)}
    found = (file.parent.relative_to(run) for file in _maps_in(run))
    names |= {place.as_posix() for place in found if 1 <= len(place.parts) <= 2}
    chosen = sorted(name for name in names if not name.startswith(".") and matches_any(name, patterns))
    if not chosen:
        raise InputError(f"{run}: no {'scene matches' if names else 'disparity maps there'} (SCENE/{_MAP})")
    return chosen


def _maps_in(run: Path) -> Iterator[Path]:
    return (file for depth in ("*", "*/*") for file in run.glob(f"{depth}/{_MAP}"))


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
