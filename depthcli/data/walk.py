"""From a folder to its scenes: the one place that walks, names, matches and keeps what is broken apart."""

from __future__ import annotations

import fnmatch
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from depthcli.core.errors import InputError
from depthcli.data.layouts import Folder, Layout, layouts
from depthcli.data.scenes import Scene


def discover_scenes(
    folder: Path | str,
    kinds: Iterable[type[Scene]] | None = None,
    layout: str | None = None,
    patterns: Sequence[str] = ("*",),
    warn: Callable[[str], None] = lambda line: None,
) -> list[Scene]:
    """The scenes of a folder, sorted by name; no image is opened.

    ``folder`` may be one scene, a folder of scenes, or a folder of such folders (names are then
    ``<data set>/<scene>``). Folders that hold none are passed over.

    Parameters
    ----------
    folder : where to look
    kinds : kinds of scene that are wanted; None: all
    layout : name of a layout; None recognizes it, for every folder by itself
    patterns : shell patterns, one of which the name, or its last part, must match
    warn : told about folders that hold scenes too deep to be looked at

    Raises
    ------
    InputError
        No such folder, no scene, no match for a pattern; or ``folder`` is itself an scene that fits two layouts, has
        a broken meta.json or the like. An scene below it with such a problem is listed with its ``problem``.
    """
    folder = Path(folder)
    wanted = _wanted(None if kinds is None else tuple(kinds), layout)
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder")
    asked = wanted[0].name if layout else ""
    found = _scenes_of(Folder(folder, folder.resolve().name, "", asked), wanted)
    if not found:
        for child in _subfolders(folder):
            here = _scenes_or_problem(child, child.name, wanted, asked)
            if not here:
                for grandchild in _subfolders(child):
                    name = f"{child.name}/{grandchild.name}"
                    inside = _scenes_or_problem(grandchild, name, wanted, asked)
                    if not inside:
                        _look_deeper(grandchild, wanted, warn)
                    here += inside
            found += here
    if not found:
        files = "; ".join(f"{each.name}: {each.wants.replace('`', '').partition(';')[0]}" for each in wanted)
        raise InputError(f"{folder}: no scenes found in it or two levels below (looked for {files})")
    return chosen_scenes(found, patterns, folder)


def chosen_scenes(scenes: Sequence[Scene], patterns: Sequence[str], place: Path | str) -> list[Scene]:
    """Those whose name matches one of the patterns, sorted by name.

    Raises
    ------
    InputError
        A pattern matches none of them; ``place`` is where they are.
    """
    found = sorted(scenes, key=lambda scene: scene.name)
    chosen = [scene for scene in found if matches_any(scene.name, patterns)]
    for pattern in patterns:
        if not any(matches_any(scene.name, [pattern]) for scene in found):
            there = ", ".join(scene.name for scene in found[:6])
            raise InputError(
                f"{place}: no scene matches {pattern!r}; there are: {there}{', ...' if len(found) > 6 else ''}"
            )
    return chosen


def scene_with_file(file: Path) -> Scene | None:
    """The scene that ``file`` belongs to by the layout of its folder or of the one above (KITTI); None for none."""
    return next(iter(scenes_with_files([file]).values()), None)


def scenes_with_files(files: Iterable[Path]) -> dict[Path, Scene]:
    """File -> the scene that it belongs to, as :func:`scene_with_file`, of those that belong to one."""
    known: dict[Path, dict[Path, Scene]] = {}
    found: dict[Path, Scene] = {}
    for file in files:
        path = file.absolute()
        for place in path.parents[:2]:
            if place not in known:
                known[place] = _files_in(place)
            if path in known[place]:
                found[file] = known[place][path]
                break
    return found


def _files_in(place: Path) -> dict[Path, Scene]:
    """File -> scene, of the scenes that lie in ``place`` by any layout."""
    try:
        inside = [scene for each in layouts() for scene in each.scenes(Folder(place, place.name, ""))]
    except InputError:
        return {}
    found: dict[Path, Scene] = {}
    for scene in inside:
        for value in vars(scene).values():
            if isinstance(value, Path):
                found.setdefault(value, scene)
    return found


def _wanted(kinds: tuple[type[Scene], ...] | None, layout: str | None) -> tuple[Layout, ...]:
    fitting = tuple(each for each in layouts() if kinds is None or issubclass(each.kind, kinds))
    if layout is None:
        return fitting
    name = layout.lower().replace("_", "-")
    chosen = tuple(each for each in fitting if each.name == name)
    if not chosen:
        raise InputError(f"no layout called {layout!r}; one of: {', '.join(each.name for each in fitting)}")
    return chosen


def _scenes_of(folder: Folder, wanted: tuple[Layout, ...]) -> list[Scene]:
    """Scenes that ``folder`` itself holds: one by its own files, or many as a KITTI root."""
    found = {each.name: scenes for each in wanted if (scenes := each.scenes(folder))}
    if len(found) > 1:
        raise InputError(f"{folder.path}: fits the layouts {' and '.join(sorted(found))}; say which with --layout")
    return next(iter(found.values()), [])


def _scenes_or_problem(path: Path, name: str, wanted: tuple[Layout, ...], asked: str = "") -> list[Scene]:
    """As ``_scenes_of``; a folder that cannot be used is one scene with its problem, and spoils no other."""
    try:
        return _scenes_of(Folder(path, name, name + "/", asked), wanted)
    except InputError as error:
        return [BrokenScene(name=name, folder=path, problem=str(error))]


def _look_deeper(folder: Path, wanted: tuple[Layout, ...], warn: Callable[[str], None]) -> None:
    """Warn of scenes one level below the deepest that is looked at."""
    for child in _subfolders(folder):
        if any(not scene.problem for scene in _scenes_or_problem(child, child.name, wanted)):
            warn(f"{child}: lies too deep, not used; to use it, give {folder} or {folder.parent} as the folder")
            return


def _subfolders(folder: Path) -> list[Path]:
    try:
        return sorted(entry for entry in folder.iterdir() if not entry.name.startswith(".") and entry.is_dir())
    except OSError:
        return []


def matches_any(name: str, patterns: Sequence[str]) -> bool:
    """One of the shell patterns matches the name or its last part."""
    last = name.rpartition("/")[2]
    return any(fnmatch.fnmatchcase(name, each) or fnmatch.fnmatchcase(last, each) for each in patterns)


class BrokenScene(Scene):
    """A folder that is meant to be an scene but cannot be used."""

    @property
    def input_files(self) -> dict[str, Path]:
        """None that could be told."""
        return {}

    def load(self) -> None:
        """Always the problem."""
        self.check()
