"""The runs that are evaluated: their names, and how the maps of each are named and coded."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import TypeVar

from depthcli.core.errors import ConfigError, InputError
from depthcli.evaluation.comparison import run_names
from depthcli.evaluation.map_files import MapOptions, found_patterns, map_paths
from depthcli.evaluation.protocols import AnyProtocol
from depthcli.io.formats.files import shown
from depthcli.io.inputs import local
from depthcli.run.command import Values

ValueT = TypeVar("ValueT")

_N_SHOWN = 5  # patterns, or files, in a message


def find_runs(runs: Sequence[Path | str]) -> dict[str, Path]:
    """Return name -> folder or file of every run.

    Parameters
    ----------
    runs : ``PLACE``, which is called by its folder's name, or ``NAME=PLACE``

    Raises
    ------
    InputError
        There is none, a place does not exist, or two runs have one name.
    """
    given = [_split(str(run)) for run in runs]
    if not given:
        raise InputError("no run to evaluate")
    given = [(name, local(place)) for name, place in given]
    if absent := [place for _, place in given if not (os.path.isdir(place) or os.path.isfile(place))]:
        raise InputError(f"{shown(absent[0])}: no such folder")
    places = [place for name, place in given if not name]
    unnamed = iter(run_names(places) if places else [])
    names = [name or next(unnamed) for name, _ in given]
    if twice := [name for name in names if names.count(name) > 1]:
        raise InputError(f"two runs are called {twice[0]}: give one of them another name, NAME=DIR")
    return dict(zip(names, [place for _, place in given], strict=True))


def _split(text: str) -> tuple[str, Path]:
    """Name, or an empty text, and place of a run."""
    name, equals, place = text.partition("=")
    if equals and name and place and not os.path.exists(text) and "/" not in name:
        return name, Path(place)
    return "", Path(text)


def by_run(
    option: str, texts: Sequence[str], runs: Mapping[str, Path], parse: Callable[[str], ValueT]
) -> tuple[ValueT | None, dict[str, ValueT]]:
    """Return the value for all runs, or None, and run -> value of those that have their own.

    Parameters
    ----------
    option : named in messages
    texts : each ``VALUE``, or ``NAME=VALUE``
    runs : name -> place
    parse : makes a value of a text, or raises ValueError with what is wanted

    Raises
    ------
    ConfigError
        Not such a value, no run of that name, or two values for one.
    """
    made: dict[str, ValueT] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if equals and name not in runs:
            raise ConfigError(f"{option} {text}: no run is called {name!r}; one of: {', '.join(runs)}")
        name, value = (name, value) if equals else ("", text)
        if name in made:
            raise ConfigError(f"{option}: two values for {name or 'all runs'}")
        try:
            made[name] = parse(value)
        except ValueError as error:
            raise ConfigError(f"{option}: {error} (got {value!r})") from None
    return made.pop("", None), made


def given_map_options(values: Values) -> tuple[float | None, float | None, dict[str, MapOptions]]:
    """Return scale and value of no value for all runs, and what was given for each run.

    Raises
    ------
    ConfigError
        ``--maps``, ``--scale`` or ``--invalid`` is wrong.
    InputError
        As :func:`find_runs`.
    """
    places = find_runs(values["runs"])
    pattern, patterns = by_run("--maps", values["maps"] or [], places, pattern_of)
    scale, scales = by_run("--scale", values["scale"] or [], places, positive)
    invalid, invalids = by_run("--invalid", values["invalid"] or [], places, number_of)
    options = {r: MapOptions(patterns.get(r) or pattern or "", scales.get(r), invalids.get(r)) for r in places}
    return scale, invalid, options


def pattern_of(text: str) -> str:
    """Return the pattern of a run's maps, such as ``{scene}/disparity.tiff``; ValueError where it is none."""
    rest, path = text.replace("{scene}", ""), PurePosixPath(text)
    if not text or "{" in rest or "}" in rest or path.is_absolute() or ".." in path.parts or not path.suffix:
        raise ValueError("want the path of a scene's map in the run folder, such as '{scene}/disparity.tiff'")
    return str(path)


def number_of(text: str) -> float:
    """Return a number, nan among them; ValueError where it is none."""
    try:
        return float(text)
    except ValueError:
        raise ValueError("want a number") from None


def positive(text: str) -> float:
    """Return a number from 1e-6 on; ValueError where it is none."""
    value = number_of(text)
    if not 1e-6 <= value < float("inf"):
        raise ValueError("want a number from 1e-6 on")
    return value


def names_in_run(scene: str, folder: Path | None, unique: bool) -> list[str]:
    """Return the names that a scene may have in a run folder, the longest form first.

    Parameters
    ----------
    folder : that of the scenes, or None
    unique : no other scene has its short name
    """
    of_folder = [] if folder is None else [f"{folder.resolve().name}/{scene}"]
    return [scene, *of_folder, *([scene.rpartition("/")[2]] if unique else [])]


def _has_standard_map(folder: Path, protocol: AnyProtocol, names: Sequence[str]) -> bool:
    try:
        return protocol.files.find(folder, names) is not None
    except InputError:  # several files claim to be the map: an error of that scene alone
        return True


def recognized(
    run: str,
    folder: Path,
    options: MapOptions,
    scenes: Mapping[str, tuple[AnyProtocol, Sequence[str]]],
    fits: Callable[[str, Path, MapOptions], bool],
) -> MapOptions:
    """Return the options with the one pattern that the maps of a run have where none has a usual place.

    Parameters
    ----------
    run, folder : name and folder of the run
    options : what was given for the run
    scenes : scene -> its protocol, and the names that it may have in the run folder
    fits : whether a file can be read as the map of a scene with such options

    Raises
    ------
    InputError
        Several patterns are as frequent, and not exactly one of them is that of files that can be read; the message
        names the files and gives a ``--maps``.
    """
    if options.pattern or any(_has_standard_map(folder, *scene) for scene in scenes.values()):
        return options
    suffixes = tuple({suffix: None for protocol, _ in scenes.values() for suffix in protocol.files.endings})
    found = found_patterns(folder, {scene: names for scene, (_, names) in scenes.items()}, suffixes)
    max_scenes = max(map(len, found.values()), default=0)
    likely = [pattern for pattern, of in found.items() if len(of) == max_scenes][:_N_SHOWN]
    if not likely:
        return options
    if len(likely) == 1:
        return MapOptions(likely[0], options.scale, options.invalid)
    fitting = []
    for pattern in likely:
        scene = found[pattern][0]
        chosen = MapOptions(pattern, options.scale, options.invalid)
        path = chosen.files(scenes[scene][0].files).find(folder, scenes[scene][1])
        if path is not None and fits(scene, path, chosen):
            fitting.append(chosen)
    if len(fitting) == 1:
        return fitting[0]
    files = ", ".join(path for path, _ in zip(map_paths(folder, suffixes), range(_N_SHOWN), strict=False))
    best = fitting[0].pattern if fitting else likely[0]
    why = f"{len(fitting)} kinds of file can be the maps" if fitting else "no file there can be read as a map"
    raise InputError(f"{shown(folder)}: {why} ({files}, ...); say which: --maps '{run}={best}'")
