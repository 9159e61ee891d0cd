"""From a folder to its scenes: which layouts are tried and where, how scenes are named, broken scenes."""

from __future__ import annotations

import contextlib
import fnmatch
import gc
import os
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

from depthcli.core.errors import InputError
from depthcli.io.formats.files import RUN_FILE, read_bytes
from depthcli.io.inputs import archives_in, gathered, local
from depthcli.io.layouts.base import Folder, Layout, Layouts
from depthcli.io.layouts.rows import rows_in_file
from depthcli.io.scenes import Scene, StereoScene

_LEVELS = 2  # below the given folder, that scenes are looked for in: data sets, and scenes in them
_MAX_ABOVE = 6  # folders above a file that its layout is looked for in: Driving, of the Scene Flow datasets, is deepest
_MAX_RUN_BYTES = 1 << 20  # of it; all presets have below 10 kB


class NoScenesError(InputError):
    """A folder without any scene of the wanted kinds."""


@contextlib.contextmanager
def _no_collections() -> Iterator[None]:
    """Keep Python from looking for garbage: of hundreds of thousands of new objects that stay, it takes a fifth."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


@_no_collections()
def discover_scenes(
    folder: Path | str,
    layouts: Layouts[Any],
    layout: str | None = None,
    patterns: Sequence[str] = ("*",),
    warn: Callable[[str], None] = lambda line: None,
) -> list[Scene]:
    """Return the scenes of a folder or an archive, sorted by name; no image is opened.

    ``folder`` may be one scene, a folder of scenes, or a folder of such folders (names are then
    ``<data set>/<scene>``). Folders without any are skipped, and so are folders of runs in it: their results are
    no scenes. Runs of ``sample`` are, and ``folder`` itself may be a run (of ``rectify``). A scene that cannot be used
    is listed with its ``problem``; InputError where ``folder`` itself is one, or there is none.

    Parameters
    ----------
    layouts : those that are tried, such as ``PAIRS``
    layout : name of a layout, or a YAML file of layouts; None recognizes it, for every folder by itself
    patterns : shell patterns, one of which the name, or its last part, must match
    warn : called with a line about folders of runs, and about scenes on other levels, which are not used
    """
    folder = local(folder)
    if not os.path.isdir(folder):
        is_file = os.path.isfile(folder)
        raise InputError(f"{folder}: {'a file, expected a folder or an archive' if is_file else 'no such folder'}")
    wanted = _wanted(layouts, layout)
    found = _find(folder, wanted, layout, warn) if wanted else []
    if not found and (known := layouts.with_plugins()) != layouts:  # asked where no other fits
        wanted = _wanted(known, layout)
        found = _find(folder, wanted, layout, warn)
    if not wanted:
        names = ", ".join(each.name for each in layouts.with_plugins().rows)
        raise InputError(f"no layout called {layout!r}; one of: {names}")
    if not found and (archives := archives_in(folder)):
        return discover_scenes(gathered(archives), layouts, layout, patterns, warn)
    if not found:
        names = ", ".join(each.name for each in wanted)
        looked_for = f"files of the layouts {names}: see docs/reference/data.md"
        if len(wanted) == 1:
            looked_for = f"{names}: {wanted[0].wants.replace('`', '').partition(';')[0]}"
        raise NoScenesError(f"{folder}: no scenes found in it or two levels below (looked for {looked_for})")
    return chosen_scenes(found, patterns, folder)


def _wanted(layouts: Layouts[Any], name: str | None) -> tuple[Layout, ...]:
    """Return all layouts, or the one of that name, or a user's file of them for this kind of scene."""
    if name and name.endswith((".yaml", ".yml")):
        return tuple(row for row in rows_in_file(Path(name)) if issubclass(row.kind, layouts.kind))
    name = name and name.lower().replace("_", "-")
    return tuple(each for each in layouts.rows if name in (None, each.name))


def _find(folder: Path, wanted: tuple[Layout, ...], layout: str | None, warn: Callable[[str], None]) -> list[Scene]:
    """Return the scenes of a folder, or of the folders in it; ``layout`` is the user's name."""
    requested = wanted[0].name if layout else ""
    found = _scenes_of(Folder(folder, folder.resolve().name, "", requested), wanted)
    if found:
        _tell_of_more(folder, found[0], wanted, requested, warn)
    found = found or _find_below(folder, (), wanted, requested, warn)
    if found and (beside := archives_in(folder)):  # what these were unpacked from, perhaps
        more = f" and {len(beside) - 1} more" if len(beside) > 1 else ""
        warn(f"{folder}: {beside[0].name}{more} beside the scenes not read; to use it, name it itself")
    return found


def _find_below(
    folder: Path, above: tuple[str, ...], wanted: tuple[Layout, ...], requested: str, warn: Callable[[str], None]
) -> list[Scene]:
    """Return the scenes of the folders in a folder, named by the folders ``above`` them, too; tell of deeper ones."""
    found: list[Scene] = []
    for child in _subfolders(folder, warn):
        parts = (*above, child.name)
        scenes = _scenes_or_problem(child, "/".join(parts), wanted, requested)
        if len(parts) <= _LEVELS:
            found += scenes or _find_below(child, parts, wanted, requested, warn)
        elif any(not scene.problem for scene in scenes):
            warn(f"{child}: lies too deep, not used; to use it, give {folder} or {folder.parent} as the folder")
            break
    return found


def _tell_of_more(
    folder: Path, first: Scene, wanted: tuple[Layout, ...], requested: str, warn: Callable[[str], None]
) -> None:
    """Warn of the scenes of a folder's folders if it has scenes itself, which alone are used."""
    own = {file for file in vars(first).values() if isinstance(file, Path)}
    for child in _subfolders(folder, lambda line: None):
        if not any(child in file.parents for file in own):
            scenes = _scenes_or_problem(child, child.name, wanted, requested)
            if any(not scene.problem for scene in scenes):
                warn(f"{child}: its scenes lie beside those of {folder} itself, not used; to use them, give it alone")


def _scenes_of(folder: Folder, wanted: tuple[Layout, ...]) -> list[Scene]:
    """Scenes of ``folder`` itself: one by its own files, or many as a KITTI root."""
    matching = {each.name: scenes for each in wanted if (scenes := each.scenes(folder))}
    if len(matching) > 1:
        raise InputError(f"{folder.path}: fits the layouts {' and '.join(sorted(matching))}; say which with --layout")
    return next(iter(matching.values()), [])


def _scenes_or_problem(path: Path, name: str, wanted: tuple[Layout, ...], requested: str) -> list[Scene]:
    """Return the scenes of a folder; one that cannot be used is one scene with its problem, and spoils no other."""
    try:
        return _scenes_of(Folder(path, name, name + "/", requested), wanted)
    except InputError as error:
        return [Scene(name=name, folder=path, problem=str(error))]


def _subfolders(folder: Path, warn: Callable[[str], None]) -> list[Path]:
    """Return the folders in a folder, but for those with results of runs other than of ``sample``."""
    try:
        with os.scandir(folder) as entries:
            found = [folder / name for name in sorted(e.name for e in entries if e.name[0] != "." and e.is_dir())]
    except OSError:
        return []
    kept = []
    for child in found:
        command = None
        with contextlib.suppress(InputError):
            if os.path.isfile(file := f"{child}/{RUN_FILE}"):
                text = read_bytes(file, _MAX_RUN_BYTES).decode("utf-8", "replace")
                command = re.search(r"^run:\n  command: (\S+)$", text, re.MULTILINE)
        if command is None or command[1] == "sample":
            kept.append(child)
        else:
            warn(f"{child}: holds a run, its results are left out of the scenes; to use them, give it as the folder")
    return kept


def chosen_scenes(scenes: Sequence[Scene], patterns: Sequence[str], place: Path | str) -> list[Scene]:
    """Return the scenes whose name matches one of the patterns, sorted by name; frames know their sequence."""
    ordered = _with_sequences(scenes)
    chosen = [scene for scene in ordered if matches_any(scene.name, patterns)]
    for scene, after in pairwise(ordered):
        if scene.name == after.name:
            raise InputError(f"{place}: two scenes are called {scene.name!r} (in {scene.folder} and {after.folder})")
    for pattern in patterns:
        if not any(matches_any(scene.name, [pattern]) for scene in ordered):
            there = ", ".join(scene.name for scene in ordered[:6])
            raise InputError(
                f"{place}: no scene matches {pattern!r}; there are: {there}{', ...' if len(ordered) > 6 else ''}"
            )
    return chosen


def _with_sequences(scenes: Sequence[Scene]) -> list[Scene]:
    """Return the scenes by name, of which stereo pairs know three frames of their sequence.

    Pairs whose left and right images are in the same two folders, or which are frames of the same two videos, are a
    sequence in the order of their names.
    """
    ordered = sorted(scenes, key=lambda scene: scene.name)
    frames: dict[tuple[str, str, bool], list[StereoScene]] = {}
    for scene in ordered:
        if isinstance(scene, StereoScene) and scene.right is not None and not scene.problem:
            views, of_video = (str(scene.left), str(scene.right)), scene.frame_number is not None
            left, right = views if of_video else map(os.path.dirname, views)  # Path.parent takes long
            frames.setdefault((left, right, of_video), []).append(scene)
    three: dict[str, tuple[StereoScene, ...]] = {}
    for same in frames.values():
        if len(same) > 1:
            some = tuple(dict.fromkeys((same[0], same[len(same) // 2], same[-1])))
            three |= {scene.name: some for scene in same}
    return [
        replace(scene, sequence=three[scene.name]) if isinstance(scene, StereoScene) and scene.name in three else scene
        for scene in ordered
    ]


def scenes_with_files(files: Iterable[Path], layouts: Layouts[Any]) -> dict[Path, Scene]:
    """Return file -> the scene that it belongs to by the layout of its folder or of one above it (KITTI), if any."""
    rows = layouts.with_plugins().rows
    known: dict[Path, dict[Path, Scene]] = {}
    scene_of: dict[Path, Scene] = {}
    for file in files:
        path = file.absolute()
        for place in path.parents[:_MAX_ABOVE]:
            if place not in known:
                known[place] = {}
                with contextlib.suppress(InputError):
                    inside = [scene for each in rows for scene in each.scenes(Folder(place, place.name, ""))]
                    for one in reversed(inside):  # of two scenes with one file, the first
                        known[place] |= {value: one for value in vars(one).values() if isinstance(value, Path)}
            if path in known[place]:
                scene_of[file] = known[place][path]
                break
    return scene_of


def matches_any(name: str, patterns: Sequence[str]) -> bool:
    """Return whether one of the shell patterns matches the name or its last part."""
    last = name.rpartition("/")[2]
    return any(fnmatch.fnmatchcase(name, each) or fnmatch.fnmatchcase(last, each) for each in patterns)
