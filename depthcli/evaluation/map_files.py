"""The runs that are evaluated, and the places of their maps: the scored file of a scene, and its companions."""

from __future__ import annotations

import itertools
import os
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any

from depthcli.core.errors import ConfigError, InputError
from depthcli.core.plugins import loaded
from depthcli.io.formats.files import shown
from depthcli.io.formats.map_format import MAP_SUFFIXES, map_formats
from depthcli.io.scenes.places import local

_N_SHOWN = 5  # patterns, or files, in a message
_MAX_LISTED = 50_000  # files of a run folder that are looked at
# Words in the names of files that are no maps of the left view.
_OTHER_WORDS = re.compile(
    r"(?<![a-z])(confidence|conf|uncertainty|sigma|(?<!expected_)errors?|err|masks?|valid|nonocc|occ|noc|disc|right|gt|"
    "truth|groundtruth|bound|probability|preview|status|colou?r|colored|rgb|image|img|im|view|texture|vis|viz|overlay|intensity|fixed|"
    "moving)(?![a-z])"
)
_OTHER_STEMS = ("left", "{scene}_left")

PROBABILITY = "probability"
"""Name of the confidence in the file ``probability``."""


@dataclass(frozen=True)
class MapFiles:
    """Names under which a run folder may have the maps of its scenes."""

    places: tuple[str, ...]  # path of the map of ``{scene}`` in the run folder, without the ending; the first is taken
    suffixes: tuple[str, ...]  # endings of a map; the first that exists is taken
    other_places: tuple[str, ...] = ()  # names of other forms that ``candidates`` knows, in words

    @property
    def endings(self) -> tuple[str, ...]:
        """All endings of a map: ``suffixes`` and, for maps of one channel, the endings of plug-ins' formats."""
        return (*self.suffixes, *sorted(map_formats())) if loaded and ".pfm" in self.suffixes else self.suffixes

    def candidates(self, folder: Path, scene: str) -> Iterator[Path]:
        """Yield the paths that the map of a scene may have, in order of preference; they need not exist."""
        for place in self.places:
            for suffix in self.endings:
                yield folder / (place.replace("{scene}", scene) + suffix)

    def find(self, folder: Path, names: Sequence[str]) -> Path | None:
        """Return the map of the scene with any of these names. Raise InputError if several files claim to be it."""
        return next((path for name in names for path in self.candidates(folder, name) if os.path.isfile(path)), None)

    def searched(self, names: Sequence[str]) -> str:
        """Return the places that ``find`` looks at, in words for an error message."""
        ending = ".*" if len(self.endings) > 1 else self.endings[0]
        named = [*(f"{place}{ending}" for place in self.places), *self.other_places]
        short = names[0].rpartition("/")[2]
        several = "" if short in names else f"; several scenes are called {short}, so that the name needs its folder"
        return f" (looked for {', '.join(named).replace('{scene}', 'SCENE')}{several})"

    def companion(self, path: Path, name: str) -> Path | None:
        """Return the file ``bound``, ``probability`` or ``status.png`` in the folder of a map, or None."""
        file = path.with_name(name if "." in name else f"{name}.pfm")
        return file if self._in_run_folder(path) and file.is_file() else None

    def confidences(self, path: Path) -> dict[str, Path]:
        """Return name -> file of the confidence maps in the folder of a map: ``confidence_<name>.pfm`` or ``.npy``.

        ``confidence.pfm`` has the name ``confidence``.
        """
        files = {}
        for file in sorted(path.parent.glob("confidence*")) if self._in_run_folder(path) else ():
            if file.suffix.lower() in (".pfm", ".npy") and re.match(r"confidence(_|$)", file.stem):
                files[file.stem.removeprefix("confidence_")] = file
        return files

    def planes(self, path: Path) -> dict[str, Path]:
        """Return name -> file of the confidence maps, and of ``PROBABILITY``, in the folder of a map."""
        files, probability = self.confidences(path), self.companion(path, PROBABILITY)
        if PROBABILITY in files:  # of a network that chooses among maps: confidence_probability.pfm
            files[f"confidence_{PROBABILITY}"] = files.pop(PROBABILITY)
        return files | ({} if probability is None else {PROBABILITY: probability})

    def _in_run_folder(self, path: Path) -> bool:
        """Return whether the map is named as in a run folder, so that the other files of its folder belong to it."""
        return path.stem in [Path(place).stem for place in self.places]


@dataclass(frozen=True)
class DisparityFiles(MapFiles):
    """Disparity maps of our runs and of the benchmarks' submissions."""

    places: tuple[str, ...] = ("{scene}/disp_left", "{scene}", "disp_0/{scene}", "low_res_two_view/{scene}")
    suffixes: tuple[str, ...] = MAP_SUFFIXES
    other_places: tuple[str, ...] = ("{scene}/disp0METHOD.pfm",)

    def candidates(self, folder: Path, scene: str) -> Iterator[Path]:
        """Yield the files that may be the map, those of the Middlebury v3 kit last: ``disp0METHOD(_s).pfm``."""
        yield from super().candidates(folder, scene)
        inside = folder / scene
        kit = sorted(path for path in inside.glob("disp0*.pfm") if not path.stem.startswith("disp0GT"))
        dense = [path for path in kit if not path.stem.endswith("_s")] or kit
        named = [path for path in dense if path.stem == f"disp0{folder.resolve().name}"] or dense
        if len(named) > 1:
            raise InputError(f"{inside}: both {named[0].name} and {named[1].name}; keep one method in a folder")
        yield from named


@dataclass(frozen=True)
class MapNaming:
    """Options for the names and codes of one run's maps; None: the option for all runs."""

    # Path of the map of ``{scene}`` in the run folder, with its ending or ``.*``; empty: the protocol's.
    pattern: str = ""
    scale: float | None = None  # codes per unit
    invalid: float | None = None  # value that means none
    any_scale: bool = False  # ``scale`` was given for this run, and applies to files of any kind

    def over(self, other: MapNaming) -> MapNaming:
        """Return these options, with missing ones from the others."""
        invalid = other.invalid if self.invalid is None else self.invalid
        any_scale = self.any_scale or (self.scale is None and other.any_scale)
        return MapNaming(self.pattern or other.pattern, self.scale or other.scale, invalid, any_scale)

    def files(self, default: MapFiles) -> MapFiles:
        """Return the places of the run's maps, ``default`` without a pattern."""
        any_ending = self.pattern.endswith(".*")
        of_pattern = MapFiles((self.pattern.removesuffix(".*"),), default.suffixes if any_ending else ("",))
        return of_pattern if self.pattern else default


def find_runs(runs: Sequence[Path | str]) -> dict[str, Path]:
    """Return name -> folder or file of every run. ``NAME=PLACE`` gives the name; ``PLACE`` has its folder's name.

    Raise InputError if there is no run, a place does not exist, or two runs have one name.
    """
    pairs = []
    for text in map(str, runs):
        name, equals, place = text.partition("=")
        named = equals and name and place and not os.path.exists(text) and "/" not in name
        pairs.append((name, local(Path(place))) if named else ("", local(Path(text))))
    if not pairs:
        raise InputError("no run to evaluate")
    if absent := [place for _, place in pairs if not os.path.exists(place)]:
        raise InputError(f"{shown(absent[0])}: no such folder")
    unnamed = iter(run_names([place for name, place in pairs if not name]))
    names = [name or next(unnamed) for name, _ in pairs]
    if twice := [name for name in names if names.count(name) > 1]:
        raise InputError(f"two runs are called {twice[0]}: give one of them another name, NAME=DIR")
    return dict(zip(names, [place for _, place in pairs], strict=True))


def run_names(places: Sequence[Path]) -> list[str]:
    """Return distinct names of folders or files, with few parents. Raise InputError if two are the same."""
    parts = [place.resolve().parts for place in places]
    for depth in range(1, max(map(len, parts), default=0) + 1):
        names = ["_".join(p[-depth:]).strip("/") or "run" for p in parts]
        if len(set(names)) == len(names):
            return names
    if places:
        raise InputError("the same run is given twice")
    return []


def names_in_run(scenes: Sequence[str], folder: Path | None) -> dict[str, list[str]]:
    """Return the names that each scene of ``folder`` may have in a run folder, the longest form first."""
    count = Counter(scene.rpartition("/")[2] for scene in scenes)
    names = {}
    for scene in scenes:
        names[scene] = [scene] if folder is None else [scene, f"{folder.resolve().name}/{scene}"]
        if count[name := scene.rpartition("/")[2]] == 1:
            names[scene].append(name)
    return names


def recognized(
    run: str,
    folder: Path,
    options: MapNaming,
    scenes: Mapping[str, tuple[MapFiles, Sequence[str]]],
    fits: Callable[[str, Path, MapNaming], bool],
) -> MapNaming:
    """Return the options with the pattern of a run's maps. It is recognized if no map is in a usual place.

    A pattern is the path of a file in the folder with ``{scene}`` in place of the scene's name, such as
    ``{scene}/out/{scene}_final.pfm``. Files are left out if their name contains no scene, or shows that they are no
    such map (``confidence.pfm``, ``right.png``). If several patterns are equally frequent, the one whose files can be
    read is taken. Raise InputError, which lists files and a ``--pattern``, if this is not exactly one.

    Parameters
    ----------
    scenes : scene -> places of its maps, and the names that it may have in the run folder
    fits : whether a file can be read as the map of a scene with such options
    """
    try:
        if options.pattern or any(files.find(folder, names) for files, names in scenes.values()):
            return options
    except InputError:  # several files claim to be the map: an error of that scene alone
        return options
    suffixes = tuple({suffix: None for files, _ in scenes.values() for suffix in files.endings})
    paths = list(itertools.islice(_map_paths(folder, suffixes), _MAX_LISTED))
    words = [(scene, re.compile(rf"(?<![A-Za-z0-9]){re.escape(name)}(?![A-Za-z0-9])"))
             for scene, (_, names) in scenes.items() for name in names]  # fmt: skip
    patterns: dict[str, dict[str, None]] = {}  # pattern -> its scenes
    for path in paths:
        for scene, word in words:
            pattern, n_replaced = word.subn("{scene}", path)
            if n_replaced:
                stem = pattern.rpartition("/")[2].lower().split(".")[0]
                if stem not in _OTHER_STEMS and not _OTHER_WORDS.search(stem):
                    patterns.setdefault(pattern, {})[scene] = None
                break
    if not patterns:
        return options
    max_scenes = max(map(len, patterns.values()))
    likely = [pattern for pattern, of in sorted(patterns.items()) if len(of) == max_scenes][:_N_SHOWN]
    fitting = likely
    if len(likely) > 1:
        fitting = []
        for pattern in likely:
            chosen, scene = replace(options, pattern=pattern), next(iter(patterns[pattern]))
            place = chosen.files(scenes[scene][0]).find(folder, scenes[scene][1])
            if place is not None and fits(scene, place, chosen):
                fitting.append(pattern)
    if len(fitting) == 1:
        return replace(options, pattern=fitting[0])
    why = f"{len(fitting)} kinds of file can be the maps" if fitting else "no file there can be read as a map"
    files_there, best = ", ".join(paths[:_N_SHOWN]), (fitting or likely)[0]
    raise InputError(f"{shown(folder)}: {why} ({files_there}, ...); choose one: --pattern '{run}={best}'")


def _map_paths(folder: Path, suffixes: Sequence[str]) -> Iterator[str]:
    """Yield the paths of the files with these endings in a folder, relative to it, with ``/``, sorted."""
    for place, folders, files in os.walk(folder):
        folders.sort()
        for file in sorted(files):
            if file.lower().endswith(tuple(suffixes)):
                yield Path(place, file).relative_to(folder).as_posix()


def given_naming(
    runs: Mapping[str, Path],
    patterns: Sequence[str] | None,
    scales: Sequence[str] | None,
    invalids: Sequence[str] | None,
) -> tuple[MapNaming, dict[str, MapNaming]]:
    """Return how maps are named and coded: for all runs, and run -> options ``NAME=VALUE`` of that run alone.

    Raise ConfigError for a wrong value, an unknown run, or two values.
    """
    options: dict[str, tuple[Sequence[str] | None, Callable[[str], Any]]] = {
        "pattern": (patterns, _pattern_of), "scale": (scales, _positive), "invalid": (invalids, float)
    }  # fmt: skip
    given: dict[str, dict[str, Any]] = {run: {} for run in ("", *runs)}
    for option, (texts, parse) in options.items():
        for text in texts or ():
            name, equals, value = text.partition("=")
            if equals and name not in runs:
                raise ConfigError(f"--{option} {text}: no run is called {name!r}; one of: {', '.join(runs)}")
            name, value = (name, value) if equals else ("", text)
            if option in given[name]:
                raise ConfigError(f"--{option}: two values for {name or 'all runs'}")
            try:
                given[name][option] = parse(value)
            except ValueError as error:
                raise ConfigError(f"--{option}: {error} (got {value!r})") from None
    of_all = MapNaming(**given.pop(""))
    return of_all, {run: MapNaming(**own, any_scale="scale" in own) for run, own in given.items()}


def _pattern_of(text: str) -> str:
    """Return the pattern of a run's maps, such as ``{scene}/disparity.tiff``. Raise ValueError if it is none."""
    rest, path = text.replace("{scene}", ""), PurePosixPath(text)
    if not text or "{" in rest or "}" in rest or path.is_absolute() or ".." in path.parts or not path.suffix:
        raise ValueError("expected the path of a scene's map in the run folder, such as '{scene}/disparity.tiff'")
    return str(path)


def _positive(text: str) -> float:
    """Return the number in the text. Raise ValueError unless it is finite and at least 1e-6."""
    if not 1e-6 <= (value := float(text)) < float("inf"):
        raise ValueError("expected a number from 1e-6 on")
    return value
