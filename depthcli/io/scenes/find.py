"""Find the scenes in a folder or from a command's options: try the layouts, name the scenes, keep broken ones."""

from __future__ import annotations

import contextlib
import fnmatch
import os
import re
import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from operator import attrgetter
from pathlib import Path
from typing import Any, cast

from depthcli.core.errors import ConfigError, InputError
from depthcli.io.formats.files import RUN_FILE, read_bytes
from depthcli.io.scenes.frames import FRAMES, named_frame
from depthcli.io.scenes.kinds import RgbdScene, Scene, StereoScene, VolumePairScene
from depthcli.io.scenes.pairs import PAIRS, STDIN, named_pairs, scenes_of_table, suggested_patterns
from depthcli.io.scenes.places import is_archive, local
from depthcli.io.scenes.rows import Folder, Layout, Layouts, SceneT, fitting, rows_in_file
from depthcli.io.scenes.volumes import VOLUMES, named_volumes

ALL_KINDS = Layouts.of(Scene, *PAIRS.rows, *FRAMES.rows, *VOLUMES.rows)
"""The layouts of every kind of scene."""

_NAMED = ((StereoScene, named_pairs), (RgbdScene, named_frame), (VolumePairScene, named_volumes))
_OWN_NAMES: dict[type[Scene], str] = {  # kind of scene -> simple file names to suggest in messages
    StereoScene: "NAME_L.* and NAME_R.*",
    RgbdScene: "NAME/color.* and NAME/depth.*",
}
_TABLE_SUFFIXES = (".csv", ".tsv")
_LEVELS = 2  # folder levels to search: data sets, then their scenes
_MAX_ABOVE = 6  # parent folders to search for the layout of a file; Driving (Scene Flow datasets) is the deepest
_MAX_RUN_BYTES = 1 << 20  # of a run file; all presets are below 10 kB

Warn = Callable[[str], None]


class NoScenesError(InputError):
    """Raised if a folder has no scene of the requested kinds."""


def find_scenes(
    layouts: Layouts[SceneT],
    options: Mapping[str, Any],
    single: str,
    patterns: Sequence[str] = ("*",),
    with_truth: bool = False,
    warn: Warn = lambda line: None,
) -> list[SceneT]:
    """Return the scenes that ``input`` or the options for the files of a single scene name.

    Raises
    ------
    ConfigError
        If neither or both are given, or an option does not go with them.
    InputError
        As :func:`discover_scenes`.

    Parameters
    ----------
    layouts : layouts of the command's kind of scene: ``PAIRS``, ``FRAMES`` or ``VOLUMES``
    options : ``input``, ``name``, ``layout`` and the files of a single scene
    single : the options that name the files of a single scene, for messages
    patterns, warn : as for :func:`discover_scenes`
    with_truth : whether ground truth is needed; single files and tables have none
    """
    place, name = options["input"], options["name"]
    if named := named_scenes(layouts.kind, options):
        if place is not None:
            raise ConfigError(f"--input and {single} exclude each other")
        if with_truth:
            raise ConfigError("--evaluate needs --input: a single scene has no ground truth")
        if name is None:
            return cast(list[SceneT], chosen_scenes(named, patterns, "the command line"))
        if len(named) > 1:
            raise ConfigError(f"--name is for a single scene, these are {len(named)}")
        return [cast(SceneT, replace(named[0], name=name))]
    if place is None:
        raise ConfigError(f"give --input DIR, or {single}")
    if name is not None:
        raise ConfigError(f"--name is for a single scene, given by {single}")
    if with_truth and (place == STDIN or os.path.isfile(local(place))):
        raise ConfigError(f"{place}: --evaluate needs a folder of scenes, with their ground truth")
    try:
        return scenes_at(place, layouts, options["layout"], patterns, warn)
    except NoScenesError as error:
        suggestion = suggested_patterns(local(place)) if issubclass(StereoScene, layouts.kind) else None
        hint = single if suggestion is None else "--left {} --right {}".format(*map(shlex.quote, suggestion))
        names = next((names for kind, names in _OWN_NAMES.items() if issubclass(kind, layouts.kind)), None)
        other = f"call your own {names}, describe theirs in --layout FILE.yaml, or " if names else ""
        raise NoScenesError(f"{error}; {other}give files of other names by {hint}") from error


def named_scenes(kind: type[Scene], options: Mapping[str, Any]) -> list[Scene]:
    """Return the scenes of a kind whose files the options name. Raise ConfigError if an option is missing.

    ``left`` and ``right`` name two images, patterns, folders or videos. ``depth``, with or without ``color``, names a
    frame. ``fixed`` with ``warped``, or with ``moving`` and its transform, names a pair of volumes.
    """
    values = dict(options)
    for key, value in options.items():
        if isinstance(value, Path):
            values[key] = local(value)
    return next(named for base, named in _NAMED if issubclass(kind, base))(values)


def scenes_at(
    place: Path, layouts: Layouts[SceneT], layout: str | None, patterns: Sequence[str], warn: Warn
) -> list[SceneT]:
    """Return the scenes in a table (CSV, TSV, or ``-`` for standard input), or in a folder: :func:`discover_scenes`."""
    if place != STDIN and not (os.path.isfile(place) and place.suffix.lower() in _TABLE_SUFFIXES):
        return cast(list[SceneT], discover_scenes(place, layouts, layout, patterns, warn))
    if not issubclass(StereoScene, layouts.kind):
        raise ConfigError(f"{place}: tables list stereo pairs only; expected a folder with one folder per scene")
    return cast(list[SceneT], chosen_scenes(scenes_of_table(place), patterns, place))


def discover_scenes(
    folder: Path | str,
    layouts: Layouts[Any],
    layout: str | None = None,
    patterns: Sequence[str] = ("*",),
    warn: Warn = lambda line: None,
) -> list[Scene]:
    """Return the scenes of a folder or an archive, sorted by name. No image is opened.

    ``folder`` is one scene, a folder of scenes, or a folder of such folders (names are then ``<data set>/<scene>``).
    Folders without scenes are skipped. Folders of runs inside are skipped, too, except runs of ``sample``. ``folder``
    itself may be a run, e.g. of ``rectify``. Scenes that cannot be used are listed with their ``problem``.

    Raises
    ------
    InputError
        If ``folder`` has no scenes, or is itself a scene that cannot be used.

    Parameters
    ----------
    layouts : layouts to try, such as ``PAIRS``
    layout : name of a layout, or a YAML file of layouts; None recognizes the layout of each folder
    patterns : shell patterns; the name or its last part must match one of them
    warn : called with a line about each skipped run, and about unused scenes on other levels
    """
    path = local(folder)
    if not os.path.isdir(path):
        is_file = os.path.isfile(path)
        raise InputError(f"{path}: {'a file, expected a folder or an archive' if is_file else 'no such folder'}")
    rows = layouts.rows if layout is None else _rows(layouts, layout)
    scenes: list[Scene] = []
    if rows:
        scenes = _find(path, rows, layout, warn)
    if not scenes and (more := layouts.with_plugins()) != layouts:  # plug-ins are loaded only if no other layout fits
        rows = more.rows if layout is None else _rows(more, layout)
        scenes = _find(path, rows, layout, warn)
    if not rows:
        names = ", ".join(row.name for row in layouts.with_plugins().rows)
        raise InputError(f"no layout called {layout!r}; one of: {names}")
    if scenes:
        return chosen_scenes(scenes, patterns, path)
    archive = next((file for file in sorted(path.iterdir()) if is_archive(file)), None)
    if archive is not None:
        raise NoScenesError(f"{path}: no scenes found in it; of its archives name one, such as {archive}")
    names = ", ".join(row.name for row in rows)
    wanted = f"files of the layouts {names}: see docs/reference/data.md"
    if len(rows) == 1:
        wanted = f"{names}: {rows[0].about.replace('`', '').partition(';')[0]}"
    raise NoScenesError(f"{path}: no scenes found in it or two levels below (looked for {wanted})")


def _rows(layouts: Layouts[Any], name: str) -> tuple[Layout, ...]:
    """Return the layout with this name, or a YAML file's layouts of this kind of scene."""
    if name.endswith((".yaml", ".yml")):
        return tuple(row for row in rows_in_file(Path(name)) if issubclass(row.kind, layouts.kind))
    return tuple(row for row in layouts.rows if row.name == name.lower().replace("_", "-"))


def _find(path: Path, rows: tuple[Layout, ...], layout: str | None, warn: Warn) -> list[Scene]:
    """Return the scenes of a folder, or of the folders in it; ``layout`` is the option's value."""
    folder = Folder(path, path.resolve().name, "", rows[0].name if layout and rows else "")
    scenes = _scenes_of(folder, rows)
    if not scenes:
        return _scenes_below(folder, rows, warn)
    files = {file for file in vars(scenes[0]).values() if isinstance(file, Path)}
    for name in folder.folders:
        if not any(path / name in file.parents for file in files):
            with contextlib.suppress(InputError):
                inside = Folder(path / name, name, f"{name}/", folder.requested)
                is_run = RUN_FILE in inside.names and _is_run(inside)
                if not is_run and any(not scene.problem for scene in _scenes_of(inside, rows)):
                    place = f"its scenes lie beside those of {path} itself"
                    warn(f"{inside.path}: {place}, not used; to use them, give it alone")
    return scenes


def _scenes_below(folder: Folder, rows: tuple[Layout, ...], warn: Warn, level: int = 1) -> list[Scene]:
    """Return the scenes up to two levels below a folder; warn about deeper scenes and skipped runs.

    A folder that cannot be used becomes one scene with a problem.
    """
    scenes: list[Scene] = []
    for child in folder.folders:
        name, path = folder.prefix + child, folder.path / child
        try:
            inside = Folder(path, name, f"{name}/", folder.requested)
            if RUN_FILE in inside.names and _is_run(inside):
                place = "holds a run, its results are left out of the scenes"
                warn(f"{path}: {place}; to use them, give it as the folder")
                continue
            of_folder = _scenes_of(inside, rows)
            if not of_folder and level <= _LEVELS:
                of_folder = _scenes_below(inside, rows, warn, level + 1)
        except InputError as error:
            of_folder = [Scene(name=name, folder=path, problem=str(error))]
        if level <= _LEVELS:
            scenes += of_folder
        elif any(not scene.problem for scene in of_folder):
            give = f"{folder.path} or {folder.path.parent}"
            warn(f"{path}: lies too deep, not used; to use it, give {give} as the folder")
            break
    return scenes


def _scenes_of(folder: Folder, rows: tuple[Layout, ...]) -> list[Scene]:
    """Return the scenes of ``folder`` itself: one, or many if it is e.g. a KITTI root."""
    by_layout = {}
    for row in fitting(rows, folder.names):
        if scenes := row.scenes(folder):
            by_layout[row.name] = scenes
    if len(by_layout) > 1:
        raise InputError(f"{folder.path}: fits the layouts {' and '.join(sorted(by_layout))}; say which with --layout")
    return next(iter(by_layout.values()), [])


def _is_run(folder: Folder) -> bool:
    """Return whether a folder has results of a run of any command but ``sample``."""
    with contextlib.suppress(InputError):
        text = read_bytes(folder.path / RUN_FILE, _MAX_RUN_BYTES).decode("utf-8", "replace")
        command = re.search(r"^run:\n  command: (\S+)$", text, re.MULTILINE)
        return command is not None and command[1] != "sample"
    return False


def chosen_scenes(scenes: Sequence[Scene], patterns: Sequence[str], place: Path | str) -> list[Scene]:
    """Return the scenes whose names match one of the patterns, sorted by name; stereo pairs get their sequences."""
    ordered = _with_sequences(scenes)
    chosen = [scene for scene in ordered if matches_any(scene.name, patterns)]
    for scene, after in pairwise(ordered):
        if scene.name == after.name:
            raise InputError(f"{place}: two scenes are called {scene.name!r} (in {scene.folder} and {after.folder})")
    for pattern in patterns:
        if not chosen or (len(patterns) > 1 and not any(matches_any(scene.name, [pattern]) for scene in ordered)):
            there = ", ".join(scene.name for scene in ordered[:6])
            raise InputError(
                f"{place}: no scene matches {pattern!r}; there are: {there}{', ...' if len(ordered) > 6 else ''}"
            )
    return chosen


def _with_sequences(scenes: Sequence[Scene]) -> list[Scene]:
    """Return the scenes sorted by name; stereo pairs get the first, middle and last frame of their sequence.

    Pairs from the same two folders or the same two videos are a sequence, in the order of their names.
    """
    ordered = sorted(scenes, key=attrgetter("name"))
    frames: dict[tuple[str, str, bool], list[int]] = {}
    for index, scene in enumerate(ordered):
        if isinstance(scene, StereoScene) and scene.right is not None and not scene.problem:
            left, right, of_video = str(scene.left), str(scene.right), scene.frame_number is not None
            if not of_video:
                left, right = os.path.dirname(left), os.path.dirname(right)  # faster than Path.parent
            frames.setdefault((left, right, of_video), []).append(index)
    with_sequences = list(ordered)
    for same in frames.values():
        if len(same) > 1:
            three = dict.fromkeys((same[0], same[len(same) // 2], same[-1]))
            sequence = tuple(cast(StereoScene, ordered[index]) for index in three)
            for index in same:
                with_sequences[index] = replace(cast(StereoScene, ordered[index]), sequence=sequence)
    return with_sequences


def scenes_with_files(files: Iterable[Path], layouts: Layouts[Any]) -> dict[Path, Scene]:
    """Return file -> its scene, by the layout of the file's folder or of a parent folder (KITTI).

    Files without a scene are left out.
    """
    rows = layouts.with_plugins().rows
    by_folder: dict[Path, dict[Path, Scene]] = {}
    scene_of: dict[Path, Scene] = {}
    for file in files:
        path = file.absolute()
        for place in path.parents[:_MAX_ABOVE]:
            if place not in by_folder:
                by_folder[place] = {}
                with contextlib.suppress(InputError):
                    folder = Folder(place, place.name, "")
                    inside = [scene for row in fitting(rows, folder.names) for scene in row.scenes(folder)]
                    for scene in reversed(inside):  # the first of two scenes with the same file wins
                        by_folder[place] |= {value: scene for value in vars(scene).values() if isinstance(value, Path)}
            if path in by_folder[place]:
                scene_of[file] = by_folder[place][path]
                break
    return scene_of


def matches_any(name: str, patterns: Sequence[str]) -> bool:
    """Return whether one of the shell patterns matches the name or its last part."""
    last = name.rpartition("/")[2]
    return any(fnmatch.fnmatchcase(name, pattern) or fnmatch.fnmatchcase(last, pattern) for pattern in patterns)
